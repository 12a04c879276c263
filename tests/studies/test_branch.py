"""Branches of a run: from one state, with changes that act from then on."""

from pathlib import Path

import numpy as np
import pytest

import twin
from tests.command_line import twin as command
from tests.robot.run.test_states import same_from
from twin.kernel.errors import InputRefused
from twin.kernel.recording.reader import read
from twin.robot.experiment.fault import FAULT_KINDS
from twin.robot.run.branch import branched_experiment
from twin.robot.run.handover import BranchPoint
from twin.robot.run.run import execute
from twin.studies.branch import branch
from twin.studies.command import ignore_progress

AT, SHORT = 6.2, "duration_s=13"


@pytest.fixture(scope="module")
def pressing(tmp_path_factory: pytest.TempPathFactory) -> Path:
    return execute(twin.load("pressing"), tmp_path_factory.mktemp("pressing") / "run").recording


def fault(kind: str, onset: float = 6.5) -> str:
    known = FAULT_KINDS[kind]
    magnitude = f", {known.magnitude_key} = {known.magnitudes[1]}" if known.magnitudes else ""
    more = ", share = 0.01" if kind == "encoder_glitch" else ""
    return f'{{kind = "{kind}", target = "{known.targets[0]}", onset_s = {onset}{magnitude}{more}}}'


@pytest.mark.slow
def test_a_branch_without_a_change_is_the_run_itself(pressing: Path, tmp_path: Path):
    experiment = branched_experiment(pressing)
    point = BranchPoint(experiment, pressing, 6200)
    assert point.how == "run again from the start"
    run = execute(experiment, tmp_path / "branch", state=point.branch_state)
    assert same_from(pressing, run.recording) == AT


@pytest.mark.slow
@pytest.mark.parametrize("kind", [kind for kind in FAULT_KINDS if kind != "drive_failure"])
def test_a_fault_in_a_branch_is_that_fault_from_the_start(pressing: Path, tmp_path: Path, kind: str):
    experiment = branched_experiment(pressing, faults=[fault(kind)])
    state = BranchPoint(branched_experiment(pressing), pressing, 6200).branch_state
    branched = read(execute(experiment, tmp_path / "branch", state=state).recording)
    whole = read(execute(experiment, tmp_path / "whole").recording)
    for key in whole.fields():
        topic = key.rpartition(".")[0]
        ahead = whole.time(topic) >= AT - 1e-9
        # how fast the shaft of a drive that will break has turned in the step before is not known to the state
        first = 1 if key == "fault/1.omega_m" else 0
        np.testing.assert_array_equal(whole[key][ahead][first:], branched[key][first:], err_msg=key)


@pytest.mark.slow
def test_a_gain_that_changes_at_a_branch_is_that_change_of_an_experiment(pressing: Path, tmp_path: Path):
    """[[change]] writes the same number into the same memory at the same tick."""
    key, value = "controller.force.ki_mm_per_N_s", 9.0
    state = BranchPoint(branched_experiment(pressing), pressing, 6200).branch_state
    branched = execute(branched_experiment(pressing, [f"{key}={value}"]), tmp_path / "branch", state=state)
    changed = twin.load("pressing", [f'change=[{{t_s = {AT}, key = "{key}", value = {value}}}]'])
    a, b = read(execute(changed, tmp_path / "whole").recording), read(branched.recording)
    ahead = a.time("plant") >= AT - 1e-9
    np.testing.assert_array_equal(a["plant.F_ee_B"][ahead], b["plant.F_ee_B"])


@pytest.mark.slow
def test_branches_are_compared_in_text_and_picture(pressing: Path, tmp_path: Path):
    line = [
        "branch",
        pressing.parent,
        "--at",
        AT,
        "--set",
        "controller.force.kp_mm_per_N=8",
        "--fault",
        fault("drive_dead"),
    ]
    done = command(*line, "--set", "monitor.enabled=false", "--body", "back", "--out", tmp_path / "out", cwd=tmp_path)
    assert done.returncode == 0 and done.stdout.startswith("pressing  4 branches at 6.2 s, run again from the start\n")
    assert "drive_dead of drive_1 at 6.5 s" in done.stdout and "as it was" in done.stdout
    assert max(map(len, done.stdout.splitlines()[:-1])) <= 80
    assert (tmp_path / "out" / "branches.png").stat().st_size > 10_000
    assert sorted(path.name for path in (tmp_path / "out").iterdir() if path.is_dir()) == list("01234")


@pytest.mark.slow
@pytest.mark.parametrize(
    ("settings", "sentence"),
    [
        (["cosim.tick_ms=2"], "cosim cannot change in mid-run: steps and scheme hold for the whole run"),
        (["robot.k_s_Nm_per_rad=2"], "robot cannot change in mid-run: it fills truth and belief"),
        (["cosim.scheme=jacobi"], "cosim cannot change in mid-run"),
        (
            ["drive.unpowered.holding_Nm=0.02"],
            "drive cannot change in mid-run: a drive's internal state fits no other",
        ),
        (["drive.fmu=pmsm_foc"], "drive cannot change in mid-run"),
        (["plant.l_a_mm=80"], "lengths of the mechanism cannot change in mid-run"),
        (["controller.delay_ticks=2"], "delay: was not there before, and cannot begin in mid-run"),
        (["controller.nothing=2"], "unknown key 'nothing'"),
    ],
)
def test_what_cannot_change_in_mid_run_is_refused_by_name(pressing: Path, tmp_path: Path, settings, sentence: str):
    with pytest.raises(InputRefused, match=sentence):
        branch(pressing, ignore_progress, AT, settings, out=tmp_path)


@pytest.mark.slow
@pytest.mark.parametrize(
    ("at", "faults", "sentence"),
    [
        (99.0, ["{}"], "--at 99: expected a time within the run"),
        (None, ["{}"], "expected --at SECONDS"),
        (AT, [], "expected a change: --set, --fault or --body"),
        (AT, [fault("drive_dead", 6.0)], "--fault: onset at 6 s is before the branch at 6.2 s"),
        (AT, ["drive dead"], "--fault drive dead"),
    ],
)
def test_a_branch_that_says_too_little_or_too_much_is_refused(
    pressing: Path, tmp_path: Path, at, faults, sentence: str
):
    with pytest.raises(InputRefused, match=sentence):
        branch(pressing, ignore_progress, at, faults=faults, out=tmp_path)


@pytest.fixture(scope="module")
def stateless(tmp_path_factory: pytest.TempPathFactory) -> Path:
    experiment = twin.load("pressing", drive="modelica_dc")
    return execute(experiment, tmp_path_factory.mktemp("stateless") / "run").recording


@pytest.mark.slow
def test_a_run_without_a_state_branches_by_running_again(stateless: Path, tmp_path: Path):
    key, value = "controller.force.ki_mm_per_N_s", 9.0
    base, other = branched_experiment(stateless), branched_experiment(stateless, [f"{key}={value}"])
    point = BranchPoint(base, stateless, 6200)
    with pytest.raises(InputRefused, match=r"this run has no state: modelica_dc\.fmu"):
        print(point.branch_state)
    runs = []
    for number, experiment in enumerate((base, other)):
        with point.hand_over(experiment) as state:
            runs.append(execute(experiment, tmp_path / f"{number}", state=state).recording)
    assert same_from(stateless, runs[0]) == AT
    changed = twin.load("pressing", [f'change=[{{t_s = {AT}, key = "{key}", value = {value}}}]'], "modelica_dc")
    a, b = read(execute(changed, tmp_path / "whole").recording), read(runs[1])
    np.testing.assert_array_equal(a["plant.F_ee_B"][6200:], b["plant.F_ee_B"])


@pytest.mark.slow
def test_another_third_party_part_is_refused_in_mid_run(pressing: Path, tmp_path: Path):
    file = Path(twin.__file__).parents[1] / "examples" / "my_controller.py"
    with pytest.raises(InputRefused, match="controller cannot change in mid-run: the state of a third-party part"):
        branch(pressing, ignore_progress, AT, [f"controller.python={file}:Controller"], out=tmp_path)
