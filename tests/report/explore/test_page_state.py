"""A state of a page, its command and its file are the same experiment."""

import math
import shlex
from pathlib import Path

import pytest

from twin.kernel.errors import InputRefused
from twin.report.explore.page_state import MAX_FAULTS, PageBase, adopt_state, first_state, parse_state, save_experiment
from twin.robot.assembly.load import load_experiment

FIG4 = PageBase("fig4_force_position")
GAIN = "controller.force.kp_mm_per_N"

STATES = [
    {},
    {"set": {GAIN: 3.0, "robot.k_s_Nm_per_rad": 2}},
    {"set": {"controller.delay_ticks": 3, "controller.gravity_compensation": False, "cosim.scheme": "jacobi"}},
    {"set": {"reference.t_s": 1.25, "monitor.force_limit_N": 12}},
    {"set": {"contact.friction": 0.3}, "body": "forearm", "drive": "pmsm_foc"},
    {"set": {"drive.parameters.droop": 0.2}},
]


def options(command: str) -> tuple[list[str], str | None, str | None]:
    words = shlex.split(command)
    named = {flag: words[words.index(flag) + 1] for flag in ("--drive", "--body") if flag in words}
    sets = [words[i + 1] for i, word in enumerate(words) if word == "--set"]
    return sets, named.get("--drive"), named.get("--body")


@pytest.mark.parametrize("state", STATES)
def test_the_command_and_the_saved_file_do_what_the_state_does(
    state: dict, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
):
    monkeypatch.chdir(tmp_path)
    found = parse_state(FIG4, state)
    values = found.load().values
    assert load_experiment("fig4_force_position", *options(found.command)).values == values
    path = save_experiment(found, "mine")
    assert load_experiment(path).values == values
    text = path.read_text()
    assert all(key.rpartition(".")[2] in text for key in state.get("set", {}))
    # exactly what differs
    assert len(text.splitlines()) <= 4 + 3 * len(state.get("set", {})) + 5 * len(state.keys() - {"set"})


def test_a_number_of_a_task_is_changed_and_saved(tmp_path: Path, monkeypatch: pytest.MonkeyPatch):
    monkeypatch.chdir(tmp_path)
    found = parse_state(PageBase("massage"), {"set": {"task.2.force_N": 4}})
    assert found.load().tasks[1].force == 4.0
    assert load_experiment(save_experiment(found, "harder")).values == found.load().values


def test_no_file_is_overwritten_and_no_name_leads_elsewhere(tmp_path: Path, monkeypatch: pytest.MonkeyPatch):
    monkeypatch.chdir(tmp_path)
    (tmp_path / "there.toml").write_text("mine")
    for name, expected in (("there", "is not overwritten"), ("../x", "expected a name"), ("", "expected a name")):
        with pytest.raises(InputRefused, match=expected):
            save_experiment(parse_state(FIG4, {}), name)
    assert (tmp_path / "there.toml").read_text() == "mine" and len(list(tmp_path.iterdir())) == 1


@pytest.mark.parametrize(
    ("state", "expected"),
    [
        ([], "expected set, drive, body and faults"),
        ({"settings": ["drive.fmu='/elsewhere/x.fmu'"]}, "expected set, drive, body and faults"),
        ({"drive": "/elsewhere/x.fmu"}, "no such drive"),
        ({"drive": ["x"]}, "no such drive"),
        ({"body": "/etc/passwd"}, "no such body"),
        ({"set": []}, None),
        ({"set": [1]}, "expected at most 200 keys"),
        ({"set": {str(i): 1 for i in range(201)}}, "expected at most 200 keys"),
        ({"set": {"robot.name": "<script>"}}, "no key that can be changed"),
    ],
)
def test_a_state_that_is_none_is_refused(state: object, expected: str | None):
    if expected is None:
        assert parse_state(FIG4, state).values == {}
        return
    with pytest.raises(InputRefused, match=expected):
        parse_state(FIG4, state)


def test_settings_of_the_command_line_are_the_first_state_and_what_no_slider_shows_holds_in_all():
    given = [f"{GAIN}=3", "title=mine", "robot.joint_zero_deg.2=1.5", "reference.t_s=[0.0,1.0,6.0,9.0,19.0,20.0]"]
    base, state = first_state(PageBase("fig4_force_position", body="forearm"), given)
    assert state == {"set": {GAIN: 3.0}, "body": "forearm"}
    assert base.settings == tuple(given[1:])
    values = parse_state(base, state).load().values
    assert values == load_experiment("fig4_force_position", given, None, "forearm").values


def test_a_factor_on_the_speed_shortens_the_times_of_the_way_points():
    found = parse_state(FIG4, {"set": {"reference.t_s": 2.0}})
    before, after = (e.reference for e in (found.base_experiment, found.load()))
    assert before is not None and after is not None
    assert after.t == tuple(t / 2.0 for t in before.t) and after.p == before.p


RUNAWAY = {"kind": "drive_runaway", "target": "drive_2", "onset_s": 6, "magnitude": 2.0}


def test_faults_are_added_to_those_of_the_file_and_stand_in_the_command(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
):
    monkeypatch.chdir(tmp_path)
    glitch = {"kind": "encoder_glitch", "target": "joint_encoder_1", "onset_s": 2, "magnitude": 1.0}
    found = parse_state(PageBase("pressing"), {"faults": [RUNAWAY, glitch]})
    one, two = found.load().faults
    assert (one.kind, one.target, one.onset, one.magnitude) == ("drive_runaway", "drive_2", 6000, 2.0)
    assert (two.kind, two.onset) == ("encoder_glitch", 2000) and 0.0 < two.share < 0.5
    assert load_experiment("pressing", *options(found.command)).faults == (one, two)
    assert load_experiment(save_experiment(found, "broken")).faults == (one, two)
    again = parse_state(PageBase("broken.toml"), {"faults": [RUNAWAY]})
    assert len(again.load().faults) == 3


@pytest.mark.parametrize(
    ("fault", "expected"),
    [
        ("x", "no such kind"),
        ({"kind": ["x"]}, "no such kind"),
        ({"kind": "drive_runawy"}, "did you mean 'drive_runaway'"),
        (RUNAWAY | {"target": "evil"}, "expected a target of drive_1"),
        (RUNAWAY | {"magnitude": "1"}, "expected a number for magnitude_rad_per_s"),
        (RUNAWAY | {"onset_s": True}, "expected a number for onset_s"),
    ],
)
def test_a_fault_that_is_none_is_refused(fault: object, expected: str):
    with pytest.raises(InputRefused, match=expected):
        parse_state(FIG4, {"faults": [fault]})


def accepted(field: str, leg: int, value: float) -> dict:
    return {"text": f"{field} of {leg}", "field": field, "leg": leg, "value": value}


def test_what_was_accepted_of_a_robot_becomes_faults_from_the_start_and_the_contacts_own_key():
    found = adopt_state(
        FIG4,
        {"set": {GAIN: 3.0, "robot.k_s_Nm_per_rad": 2.0}, "drive": "", "body": ""},
        [accepted("k_s_share", 1, 0.85), accepted("slip", 0, math.radians(-2.0)), accepted("K", -1, 1000.0)],
    )
    # a share of the spring that the page has
    assert found["faults"] == [
        {"kind": "spring_softened", "target": "joint_2", "onset_s": 0.0, "magnitude": 0.425},
        {"kind": "belt_slip", "target": "joint_1", "onset_s": 0.0, "magnitude": -2.0},
    ]
    assert found["set"] == {GAIN: 3.0, "robot.k_s_Nm_per_rad": 2.0, "contact.stiffness_N_per_m": 1000.0}
    # a newer value takes the place of the one before, and other faults stay
    other = {"kind": "spring_softened", "target": "joint_3", "onset_s": 4.0, "magnitude": 0.5}
    again = adopt_state(FIG4, found | {"faults": [*found["faults"], other]}, [accepted("k_s_share", 1, 1.0)])
    assert [fault["magnitude"] for fault in again["faults"]] == [-2.0, 0.5, 0.5]


def test_what_cannot_be_taken_over_is_refused_in_a_sentence():
    with pytest.raises(InputRefused, match="mass of 0: no key of an experiment and no fault stands for it"):
        adopt_state(FIG4, {}, [accepted("mass", 0, 1.0)])
    with pytest.raises(InputRefused, match="expected a target of joint_1"):
        adopt_state(FIG4, {}, [accepted("slip", 8, 1.0)])
    with pytest.raises(InputRefused, match="expected a number for magnitude_factor"):
        adopt_state(FIG4, {}, [accepted("k_s_share", 0, math.nan)])
    full = [{"kind": "encoder_bias", "target": "joint_encoder_1", "onset_s": 1.0, "magnitude": 0.1}] * MAX_FAULTS
    with pytest.raises(InputRefused, match=f"expected at most {MAX_FAULTS} faults"):
        adopt_state(FIG4, {"faults": full}, [accepted("k_s_share", 0, 0.9)])
