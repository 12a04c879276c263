"""`twin falsify` on the pressing robot, once for all tests here."""

import json
from pathlib import Path
from typing import Any

import pytest

from tests.laws.runs import EXPERIMENTS
from tests.studies.faults.pressing import pressing
from twin.kernel.errors import InputRefused
from twin.robot.assembly.load import load_experiment
from twin.studies.command import ignore_progress
from twin.studies.falsify.judge import judge_run
from twin.studies.falsify.study import DEFAULT_RUNS, falsify
from twin.studies.faults.together import SECOND_DELAYS
from twin.studies.result import Result
from twin.studies.sweep.worker import trial

BOUND = "always (|plant.F_ee_B| <= 18 N)"


def asked(folder: Path, **options) -> Result:
    told: dict[str, Any] = {
        "experiment": EXPERIMENTS / "pressing.toml", "requirements": [BOUND], "kinds": [], "bodies": [], "reach": 0.0,
        "runs": DEFAULT_RUNS, "duration": None, "processes": 2, "drive": None, "settings": [], "out": folder,
        "say": ignore_progress,
    }  # fmt: skip
    return falsify(**told | options)


@pytest.fixture(scope="module")
def folder(tmp_path_factory: pytest.TempPathFactory) -> Path:
    return tmp_path_factory.mktemp("falsified")


BROKEN = ("stiffness_change", "belt_slip", "surface_jump")
"""Kinds that go beyond the bound at pressing.toml, see tests/studies/faults/test_matrix.py."""
SAFE = ("drive_dead", "breathing")


@pytest.fixture(scope="module")
def answer(folder: Path) -> Result:
    return asked(folder, kinds=[*BROKEN, *SAFE], runs=20)


@pytest.mark.endurance
def test_every_kind_that_the_matrix_shows_beyond_the_bound_is_found_in_a_third_of_its_runs(tmp_path: Path):
    answer = asked(tmp_path, runs=len(pressing()) * 2 // 3)
    found = {one["kind"] for one in answer.facts["found"] if one["share"] < 0.0}
    assert found >= {row.kind for row in pressing() if not row.is_safe} == set(BROKEN)
    # the matrix makes two runs of each of its cases
    assert answer.facts["runs"] <= 2 * len(pressing()) / 3
    assert max(one["first_violating_run"] for one in answer.facts["found"] if one["share"] < 0.0) <= len(pressing()) / 3
    # and each of them is found to be at least as bad
    worst = {kind: max(row.watched.peak for row in pressing() if row.kind == kind) for kind in BROKEN}
    for one in answer.facts["found"]:
        if one["kind"] in worst:
            assert one["distances"]["requirement_1"] <= 18.0 - worst[one["kind"]] + 1e-9


def test_what_violates_is_found_and_what_does_not_is_not(answer: Result):
    assert {one["kind"] for one in answer.facts["found"] if one["share"] < 0.0} == set(BROKEN)
    assert (answer.facts["runs"], answer.exit_code) == (20, 1)


def test_a_found_experiment_runs_and_violates_by_the_same_distance(answer: Result, folder: Path):
    for one in answer.facts["found"]:
        if one["share"] >= 0.0:
            assert not (folder / f"{one['kind']}.toml").exists()
            continue
        again = trial(folder / f"{one['kind']}.toml", None, ())
        assert again["metrics"]["requirement_1.distance"] == one["distances"]["requirement_1"] < 0.0


def test_the_text_fits_80_columns_and_says_the_verdict_first(answer: Result):
    lines = answer.text.splitlines()
    assert lines[0].startswith("pressing  VIOLATED by 3 of 5 kinds of fault")
    assert [line for line in lines if len(line) > 80 and ".toml" not in line] == []


def test_the_facts_are_in_the_folder(answer: Result, folder: Path):
    assert json.loads((folder / "falsify.json").read_text())["found"] == json.loads(json.dumps(answer.facts["found"]))


def test_a_joint_that_is_not_the_first_is_tried(tmp_path: Path):
    """Pressing down, joint 1 lies in the plane of y and z: what is wrong with it makes no force along x."""
    sideways = {"requirements": ["always (|plant.F_ee_B[0]| <= 0.5 N)"], "kinds": ["backlash_growth", "belt_slip"]}
    answer = asked(tmp_path, runs=20, **sideways)
    violating = {one["kind"]: one["target"] for one in answer.facts["found"] if one["share"] < 0.0}
    assert violating.keys() == set(sideways["kinds"])
    assert "joint_1" not in violating.values()


def test_a_run_that_a_failed_component_ends_is_not_kept(tmp_path: Path):
    answer = asked(tmp_path, kinds=["drive_failure", "breathing"], runs=8)
    assert answer.facts["not_violated"] == answer.facts["kept"] == ["breathing"] and answer.exit_code == 0
    assert "not violated by 1 of 2 kinds of fault" in answer.text.splitlines()[0]
    assert "Ended by a component that failed, judged until then: drive_failure" in answer.text
    assert {one["kind"] for one in answer.facts["ended_early"]} == {"drive_failure"}


@pytest.mark.parametrize(
    ("options", "told"),
    [
        ({"requirements": []}, "it has no requirement; give --requirement"),
        ({"requirements": ["always (plant.F_e <= 1 N)"]}, "no such signal as plant.F_e; did you mean .*'plant.F_ee_B'"),
        ({"requirements": ["always (|plant.F_ee_B| <= 1 mm)"]}, "units differ: N and m"),
        ({"runs": 5}, "--runs 5: there are 35 kinds of fault"),
        ({"kinds": ["drive_dad"]}, "did you mean 'drive_dead'"),
        ({"duration": 0.0}, "--duration 0: a fault lasts longer"),
        ({"experiment": EXPERIMENTS / "fig4_force_position.toml", "reach": 5.0}, r"has no \[\[task\]\] that could be"),
        ({"settings": ['fault=[{kind="drive_dead", onset_s=1.0}]']}, r"has \[\[fault\]\] tables"),
    ],
)
def test_what_cannot_be_searched_is_refused_before_a_run(tmp_path: Path, options, told):
    with pytest.raises(InputRefused, match=told):
        asked(tmp_path, **options)


def test_what_the_healthy_robot_does_not_keep_is_refused(tmp_path: Path):
    with pytest.raises(InputRefused, match=r"violated without any fault, by 1\.\d+ N; require what holds"):
        asked(tmp_path, requirements=["always (|plant.F_ee_B| <= 7 N)"], kinds=["breathing"], processes=1)


ELEVEN = "always (|plant.F_ee_B| <= 11 N)"
"""What a belief of the force that is wrong alone keeps, with 10.5 N, and breathing alone, with 8.7 N."""


@pytest.mark.parametrize(
    ("kinds", "violating"), [(("belief_eta", "breathing"), 0), (("belief_eta+breathing",), 1), (("breathing",), 0)]
)
def test_a_pair_that_no_single_fault_shows_is_found(tmp_path: Path, kinds: tuple[str, ...], violating: int):
    # two runs of a single fault are of the catalogue's largest; beyond, breathing alone violates
    answer = asked(tmp_path, requirements=[ELEVEN], kinds=kinds, runs=8 if violating else 2 * len(kinds))
    assert answer.exit_code == violating
    if violating:
        text = (tmp_path / f"{kinds[0]}.toml").read_text()
        assert text.count("[[fault]]") == 2
        # both begin together
        assert len({line for line in text.splitlines() if line.startswith("onset_s")}) == 1


def test_a_common_cause_is_searched_by_its_name(tmp_path: Path):
    kind = "drive_runaway@all_drives"
    answer = asked(tmp_path, kinds=[kind], settings=["monitor.disobeyed=wait"], runs=4)
    # a path is as long as it is
    lines = [line for line in answer.text.splitlines() if str(tmp_path) not in line]
    assert answer.exit_code == 1 and max(map(len, lines)) <= 80
    assert 'target = "all drives"' in (tmp_path / f"{kind}.toml").read_text()


@pytest.mark.slow
def test_of_poses_only_those_count_where_the_healthy_robot_keeps_what_is_required(tmp_path: Path):
    """The shoulder is a dome: beyond 11 deg the head slides, which the experiment refuses."""
    dome = ["contact.body=shoulder"]
    answer = asked(tmp_path, kinds=["surface_jump"], settings=dome, reach=30.0, runs=24)
    (found,) = answer.facts["found"]
    assert found["share"] < 0.0 and answer.exit_code == 1
    again = trial(tmp_path / "surface_jump.toml", None, ())
    assert again["metrics"]["requirement_1.distance"] == found["distances"]["requirement_1"]
    # on the flank the healthy robot pushes sideways, too
    sideways = ["always (|plant.F_ee_B[0]| <= 0.5 N)", "always (|plant.F_ee_B[1]| <= 0.5 N)"]
    flank = asked(tmp_path, requirements=sideways, kinds=["breathing"], settings=dome, reach=30.0, runs=24)
    refused = [one for one in flank.facts["ended_early"] if one["refused"]]
    assert flank.exit_code == 0 and all(one["offset_m"] != [0.0, 0.0] for one in refused)
    for reason in ("friction cannot hold", "without any fault: violated"):
        assert any(reason in one["reason"] for one in refused)


def test_drives_faster_than_the_catalogue_s_are_found_beyond_the_bound(tmp_path: Path):
    kind = "drive_runaway@all_drives"
    bound = ["always (|plant.F_ee_B| <= 22.5 N)"]
    (found,) = asked(tmp_path, requirements=bound, kinds=[kind], runs=24).facts["found"]
    (one,) = (fault for fault in load_experiment(tmp_path / f"{kind}.toml").faults if fault.target == "drive_1")
    assert found["share"] < 0.0 and 25.0 < one.magnitude <= 200.0


def test_the_second_fault_of_a_found_experiment_begins_after_the_trip_of_the_first(tmp_path: Path):
    kind = "sample_loss-then-drive_runaway@all_drives"
    old = ["monitor.disobeyed=wait", "contact.body=back"]
    answer = asked(tmp_path, kinds=[kind], settings=old, runs=4)
    (found,) = answer.facts["found"]
    assert answer.exit_code == 1 and found["after_trip_s"] in SECOND_DELAYS
    loaded = load_experiment(tmp_path / f"{kind}.toml")
    first, second = (next(fault for fault in loaded.faults if fault.table == number) for number in (1, 2))
    # messages are off their time by 10 ms
    assert second.onset - first.onset == pytest.approx(1e3 * found["after_trip_s"] + 10, abs=4)
    again = judge_run(EXPERIMENTS / "pressing.toml", None, [str(tmp_path / f"{kind}.toml")])
    assert again["metrics"]["requirement_1.distance"] == found["distances"]["requirement_1"] < 0.0
