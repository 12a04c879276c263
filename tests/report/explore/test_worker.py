"""What the processes behind the pages answer: the numbers of a run, every spike of its curves, loops; or a sentence."""

import base64
import json
import os
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from tests.laws.runs import shipped
from twin.kernel.process.reporter import DirectReporter
from twin.kernel.recording.reader import read
from twin.report.explore.picture import EXPLORED_PANELS, INITIAL_PANELS, extremes
from twin.report.explore.worker import answer_request
from twin.robot.paths import PROJECT_FOLDER
from twin.robot.run.measures import MEASURE_ROWS
from twin.robot.run.run import execute
from twin.robot.run.trace import run_in_memory
from twin.studies.analyse.linearised import Linearisation
from twin.studies.analyse.operating_point import operating_points
from twin.studies.analyse.stability import judge_point
from twin.studies.faults.onsets import default_onsets, healthy_run
from twin.studies.paper.fig4 import FIG4_EXPERIMENTS, fig4_score
from twin.studies.paper.fig4_measures import Fig4Run, Fig4Runs
from twin.studies.paper.fig5 import fig5_score

BASE: dict[str, Any] = {
    "experiment": "fig4_force_position",
    "drive": None,
    "body": None,
    "settings": [],
}
POSITION = {"experiment": "fig4_position"}
LOOK = {"panels": list(INITIAL_PANELS), "span": None, "width": 300}
GAIN = "controller.force.kp_mm_per_N"


def answer(op: str, state: object = None, base: dict[str, Any] | None = None, **more: Any) -> dict[str, Any]:
    ask = {"op": op, "state": state or {}, **LOOK, **more}
    found = answer_request(DirectReporter(lambda note: None), os.getcwd(), BASE | (base or {}), ask)
    # it goes through JSON
    return json.loads(json.dumps(found))


def curves(found: dict[str, Any]) -> dict[tuple[str, str], tuple[np.ndarray, float, float]]:
    block = np.frombuffer(base64.b64decode(found["block"]), "<f4")
    return {
        (panel["title"], row["label"]): (block[place[0] : place[0] + place[1]], place[2], place[3])
        for panel in found["panels"]
        for row in panel["rows"]
        if (place := row["curve"])
    }


def test_numbers_and_events_are_those_of_a_recorded_run(tmp_path: Path):
    run = execute(shipped("fig4_force_position", f"{GAIN}=3"), tmp_path)
    found = answer("show", {"set": {GAIN: 3}})
    for name, unit, value, *_ in found["numbers"]:
        (measure,) = (one for one in MEASURE_ROWS if one.text == name)
        of_run = run.outcome.measures[measure.key].value
        assert (unit, value) == (measure.unit.text, None if of_run is None else of_run * measure.unit.per_SI)
    assert [(e["t"], e["text"]) for e in found["events"]] == [
        (t, text) for t, level, text in run.events if level != "DEBUG"
    ]
    assert found["command"] == f"twin run fig4_force_position --set {GAIN}=3.0"


def test_the_first_tiles_are_what_a_controller_is_chosen_by():
    names = [name for name, *_ in answer("show")["numbers"]]
    assert names[:6] == [
        "hold error", "overshoot", "settling time", "chatter", "lateral error while held", "largest force"
    ]  # fmt: skip
    assert "error since the first touch" in names


def test_a_number_that_does_not_exist_says_why():
    reasons = {name: (value, reason) for name, _, value, reason, *_ in answer("show", base=POSITION)["numbers"]}
    assert reasons["hold error"] == (None, "no force loop") and reasons["largest force"][0] > 1.0
    assert [reason for value, reason in reasons.values() if value is None and not reason] == []


def reaction(experiment: str, magnitude: float, **state: Any) -> tuple[float | None, str]:
    """When the monitor reacts to a fault, or why not."""
    base = {"experiment": experiment}
    runaway = {"kind": "drive_runaway", "target": "drive_1", "onset_s": answer("onset", state, base)["onset"]}
    found = answer("show", state | {"faults": [runaway | {"magnitude": magnitude}]}, base)["numbers"]
    ((value, reason),) = [(value, why) for name, _, value, why, *_ in found if name == "monitor trips after the fault"]
    return value, reason


def test_a_run_without_a_monitor_says_so_where_its_reaction_would_stand():
    assert reaction("fig4_force_position", 0.01) == (None, "no monitor here")
    assert reaction("pressing", 0.01, set={"monitor.enabled": False}) == (None, "no monitor here")
    delay, reason = reaction("pressing", 5.0)
    assert delay is not None and 0.0 < delay < 0.5 and not reason


@pytest.mark.parametrize("faults", [[], [{"kind": "power_off", "target": "power", "onset_s": 0.5}]])
def test_a_fault_begins_where_twin_faults_lets_it_begin_in_contact(faults: list[dict[str, Any]]):
    experiment = shipped("pressing")
    onset = default_onsets(healthy_run(experiment))[1] * experiment.cosim.tick
    trace = run_in_memory(experiment)
    assert answer("onset", {"faults": faults}, {"experiment": "pressing"}) == {"onset": onset}
    assert -trace["plant.F_ee_B"][round(onset / trace.tick), 2] > 5.0


def test_where_nothing_is_touched_there_is_no_usual_onset():
    assert "touches nothing" in answer("onset", base={"experiment": "step_z_air"})["refused"]


def test_no_spike_is_lost_at_any_width_and_a_zoom_has_the_samples_themselves():
    trace = run_in_memory(shipped("fig4_force_position"))
    force = -trace["plant.F_ee_B"][:, 2]
    key = "Pressing force F_z", "true"
    for width in (10, 300, 4000):
        shown, start, step = curves(answer("show", width=width))[key]
        assert len(shown) <= 4 * width + 2
        assert (shown.min(), shown.max()) == (np.float32(force.min()), np.float32(force.max()))
        # where they are: within two samples of the picture
        at = start + step * np.argmax(shown)
        assert at == pytest.approx(np.argmax(force) * trace.tick, abs=2.5 * step)
    shown, start, step = curves(answer("show", span=[13.0, 13.2], width=300))[key]
    assert step == pytest.approx(1e-3)
    first = round(start / 1e-3)
    np.testing.assert_array_equal(shown, force[first : first + len(shown)].astype("<f4"))
    assert start <= 13.0 and start + step * (len(shown) - 1) >= 13.2


@pytest.mark.parametrize("count", [1, 2, 5, 100, 101])
def test_extremes_stand_in_their_order_and_what_is_no_number_hides_none(count: int):
    y = np.sin(37.0 * np.arange(count) ** 2)
    y[::7] = np.nan
    found = extremes(y, 6)
    for part in range(0, count, 6):
        low, high = np.fmin.reduce(y[part : part + 6]), np.fmax.reduce(y[part : part + 6])
        np.testing.assert_equal(sorted(found[part // 3 : part // 3 + 2]), sorted((low, high)))
    assert len(found) == 2 * -(-count // 6) or count <= 2


def test_the_same_curves_come_whatever_was_looked_at_before():
    first = curves(answer("show"))
    again = curves(answer("show"))
    assert first.keys() == again.keys() and all(np.array_equal(first[key][0], again[key][0]) for key in first)
    # another drive has other signals, and a tank is one more component
    for state in ({"drive": "pmsm_foc"}, {"set": {"monitor.enabled": True}}):
        assert curves(answer("show", state)).keys() >= first.keys()


def test_every_panel_that_shows_something_can_be_chosen():
    found = answer("show", list=True, robot=True)
    titles = [panel.title for panel in EXPLORED_PANELS]
    assert set(INITIAL_PANELS) < set(found["all_panels"]) <= set(titles)
    assert found["scene"]["frames"]["count"] > 100
    assert set(panel["title"] for panel in answer("show", panels=titles)["panels"]) == set(titles)


@pytest.mark.parametrize(
    ("op", "more", "expected"),
    [
        ("show", {"state": {"set": {GAIN: -1}}}, "kp_mm_per_N = -1.0: expected a number >= 0"),
        ("show", {"state": {"set": {"robot.l_b_mm": 20}}}, "out of reach"),
        ("show", {"state": 1}, "expected set, drive, body and faults"),
        ("show", {"panels": "x"}, "panels: expected"),
        ("show", {"panels": [[]]}, "panels: expected"),
        ("show", {"span": [1]}, "span: expected"),
        ("show", {"span": ["a", "b"]}, "span: expected"),
        ("show", {"span": [2.0, 1.0]}, "span: expected"),
        ("show", {"width": 10**9}, "width: expected"),
        ("show", {"width": 1.5}, "width: expected"),
        ("recorded", {"run": "/etc"}, "no such run in results/"),
        ("recorded", {"run": None}, "run: expected a run of results/"),
        ("save", {"name": "../x"}, "expected a name"),
        ("loops", {"state": {"set": {GAIN: "x"}}}, "expected a number"),
    ],
)
def test_what_cannot_be_is_a_sentence(op: str, more: dict[str, Any], expected: str, tmp_path: Path, monkeypatch: Any):
    monkeypatch.chdir(tmp_path)
    found = answer(op, **{"state": {}, **more})
    assert expected in found["refused"] and "Traceback" not in found["refused"]


def test_an_experiment_that_is_too_long_for_a_slider_is_refused():
    found = answer_request(
        DirectReporter(lambda note: None),
        os.getcwd(),
        BASE | {"settings": ["duration_s=1e5"]},
        {"op": "show", "state": {}, **LOOK},
    )
    assert "too many to be run while a slider moves" in found["refused"]


def test_loops_have_the_margins_of_twin_analyse():
    found = answer("loops", {"set": {GAIN: 3}}, point=2)
    experiment = shipped("fig4_force_position", f"{GAIN}=3")
    points, _ = operating_points(experiment)
    judged = judge_point(Linearisation(experiment, points).linear_point(points[2]))
    assert len(found["points"]) == len(points) and found["stable"]
    assert len(found["loops"]) == len(judged.margins)
    for row, one in zip(found["loops"], judged.margins.values(), strict=True):
        assert one.gain is None or row["gain_dB"] == pytest.approx(20.0 * np.log10(one.gain))
        assert one.phase is None or row["phase_deg"] == pytest.approx(np.degrees(one.phase))
    block = np.frombuffer(base64.b64decode(found["block"]), "<f4").reshape(-1, found["count"])
    # at the crossover the gain is 0 dB, and the phase margin is what is left to -180 deg
    row = next(row for row in found["loops"] if row["crossover_Hz"])
    n = found["loops"].index(row)
    assert np.interp(np.log(row["crossover_Hz"]), np.log(block[0]), block[1 + 2 * n]) == pytest.approx(0.0, abs=0.1)


@pytest.mark.parametrize("name", FIG4_EXPERIMENTS)
def test_claims_are_those_of_the_papers_four_runs_with_the_state_laid_over_each(name: str):
    found = {row["text"]: row for row in answer("score", {"set": {GAIN: 3}}, base={"experiment": name})["claims"]}
    runs = [Fig4Run(run_in_memory(shipped(one, f"{GAIN}=3"))) for one in FIG4_EXPERIMENTS]
    score = fig4_score(Fig4Runs(runs[0], runs[1], imperfect=(runs[2], runs[3])))
    judged = [one for one in (*score.claims, *score.quality) if one.claim.measure is not None]
    assert {one.claim.text: (one.verdict, one.measured_text) for one in judged} == {
        text: (row["verdict"], row["measured"]) for text, row in found.items()
    }


def test_a_state_that_tilts_the_scale_tilts_all_four():
    # of what the imperfect ones have by themselves the page's value holds
    claims = answer("score", {"set": {"contact.tilt_deg": 0.0}})["claims"]
    assert {row["text"]: row for row in claims} != {row["text"]: row for row in answer("score")["claims"]}


def test_claims_of_tasks_are_those_of_fig_5_on_the_recorded_run(tmp_path: Path):
    run = execute(shipped("pressing", f"{GAIN}=0.5"), tmp_path)
    (task,) = fig5_score([read(run.recording)]).tasks
    found = answer("score", {"set": {GAIN: 0.5}}, base={"experiment": "pressing"})
    assert found["figure"] == "fig5"
    assert [(f"1 press: {one.claim.text}", one.verdict, one.measured_text) for one in task.findings] == [
        (row["text"], row["verdict"], row["measured"]) for row in found["claims"]
    ]


def test_an_experiment_that_is_none_of_the_papers_has_no_claims_and_no_layout():
    # a step of 6 s
    assert answer("describe", base={"experiment": "step_z_air"})["figure"] is None
    assert "needs" in answer("score", base={"experiment": "step_z_air"})["refused"]
    assert (
        "not one of the paper's Fig. 4" in answer("show", base={"experiment": "step_z_air"}, layout="fig4")["refused"]
    )
    assert "not one of the paper's Fig. 4" in answer("show", base={"experiment": "pressing"}, layout="fig4")["refused"]
    assert "expected fig4" in answer("show", layout="fig5")["refused"]


def test_the_layout_of_fig_4_has_its_four_runs():
    found = answer("show", {"set": {GAIN: 3}}, layout="fig4", span=[13.0, 14.0])
    shown = curves(found)
    assert [panel["title"][0] for panel in found["panels"]] == ["A", "B", "C", "D"]
    alone, askew = (run_in_memory(shipped(FIG4_EXPERIMENTS[n], f"{GAIN}=3")) for n in (1, 3))
    for key, run, signal, column in (
        (("B: F_z, pressing", "P-based"), alone, "controller.F_z", ...),
        (("C: F_x, imperfect runs", "P-based"), askew, "estimator.F_ee_B", 0),
    ):
        values, start, _ = shown[key]
        first = round(start / 2e-3)
        np.testing.assert_array_equal(values, run[signal][first : first + len(values)].T[column].astype("<f4"))
    assert [name for name, *_ in found["numbers"]] == [name for name, *_ in answer("show")["numbers"]]


def test_a_drive_that_has_changed_the_folder_leads_nothing_astray(tmp_path: Path, monkeypatch: pytest.MonkeyPatch):
    here = tmp_path / "here"
    here.mkdir()
    (here / "mine.toml").write_text(f'extends = "{PROJECT_FOLDER}/experiments/fig4_position.toml"')
    monkeypatch.chdir(tmp_path)
    ask: dict[str, Any] = {"op": "show", "state": {}, **LOOK}
    found = answer_request(DirectReporter(lambda note: None), str(here), BASE | {"experiment": "mine.toml"}, ask)
    assert found["command"] == "twin run mine.toml"
