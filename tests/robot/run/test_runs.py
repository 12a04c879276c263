"""Runs of one study, one after the other: each has the bits of a run from the start, whatever ran before it."""

from collections.abc import Iterator, Sequence
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from tests.kernel.fmi.archives import redescribed
from tests.laws.runs import EXPERIMENTS
from twin.kernel.cosim.system import System
from twin.kernel.errors import ComponentFailed, InputRefused
from twin.robot.assembly.load import load_experiment
from twin.robot.experiment.experiment import Experiment
from twin.robot.experiment.fault import Fault
from twin.robot.run import runs as runs_module
from twin.robot.run.runs import Outcome, RunRequest, Runs
from twin.robot.run.shared_prefix import SharedPrefix

TICKS = 1200
ONSET = 900
KEPT = RunRequest(
    signals=frozenset({
        "plant.F_ee_B", "plant.p_B", "plant.theta_l", "drive/2.omega_m", "estimator.p_B", "controller.F_z_ref",
        "encoder.count_l", "monitor.tripped",
    }),
    tally=True,
    idle=True,
)  # fmt: skip
ALIVE = Fault("encoder_glitch", "joint_encoder_2", ONSET, magnitude=0.01, share=0.02, seed=3)
MOVED = Fault("surface_jump", "contact", ONSET, magnitude=5e-3)
RUNAWAY = Fault("drive_runaway", "drive_2", ONSET, magnitude=3.0)
WILD = replace(RUNAWAY, magnitude=60.0)
"""One that takes the robot to where it has no pose."""
FAULTS = (ALIVE, RUNAWAY, MOVED, ALIVE)


def begun(*settings: str, drive: str | None = None) -> Experiment:
    """The begin of pressing."""
    return replace(load_experiment(EXPERIMENTS / "pressing.toml", settings, drive), duration_ticks=TICKS)


def broken(experiment: Experiment, faults: Sequence[Fault] = FAULTS) -> list[Experiment]:
    return [replace(experiment, faults=(fault,)) for fault in faults]


def assert_same(one: Outcome, other: Outcome) -> None:
    """Whatever an outcome has but for the time that it took."""
    same = ("status", "reason", "trip", "power_off_tick", "idle", "culprit")
    assert [getattr(one, name) for name in same] == [getattr(other, name) for name in same]
    # a repr has every bit, and NaN equals itself
    assert repr(one.numbers) == repr(other.numbers) and repr(one.failure) == repr(other.failure)
    assert one.trace is not None and other.trace is not None
    np.testing.assert_array_equal(one.trace.t, other.trace.t)
    for key in other.trace.fields():
        np.testing.assert_array_equal(one.trace.held(key), other.trace.held(key), err_msg=key)


def lacking(runs: Runs) -> list[str]:
    """Of each past that was run: why it is not shared, or ""."""
    return [past.shared.lacking for past in runs._pasts if past.shared is not None]


def outcomes(experiments: Sequence[Experiment], request: RunRequest = KEPT, share: bool = True) -> list[Outcome]:
    """With a past as early as there is one; shared only if it is said."""
    with Runs(request, most=2) as runs:
        found = [runs.run(experiment) for experiment in experiments]
        assert any(reason == "" for reason in lacking(runs)) == share
    return found


def from_the_start(experiments: Sequence[Experiment], request: RunRequest = KEPT) -> list[Outcome]:
    with Runs(request, most=0) as runs:
        return [runs.run(experiment) for experiment in experiments]


@pytest.fixture(params=["usual", "noise", "measure", pytest.param("processes", marks=pytest.mark.slow), "stateless"])
def robot(request: pytest.FixtureRequest, root: Path, tmp_path: Path) -> Iterator[tuple[Experiment, bool]]:
    """(experiment, whether its runs share a past)."""
    kind = request.param
    if kind == "noise":
        yield begun("plant.motor_noise_deg=0.001", "seed=5"), True
    elif kind == "measure":
        yield begun('measure=[{name="low", kind="requirement", formula="always (plant.p_B[2] <= 0 mm)"}]'), True
    elif kind == "processes":
        flagged = '<CoSimulation canBeInstantiatedOnlyOncePerProcess="true" '
        good = root / "fmus" / "velocity_servo" / "velocity_servo.fmu"
        yield begun(drive=str(redescribed(good, tmp_path / "single.fmu", "<CoSimulation ", flagged))), True
    else:
        yield begun(drive="modelica_dc" if kind == "stateless" else None), kind != "stateless"


def test_runs_that_share_a_past_have_the_bits_of_runs_from_the_start(robot: tuple[Experiment, bool]):
    experiments = broken(robot[0])
    alone = from_the_start(experiments)
    for one, other in zip(outcomes(experiments, share=robot[1]), alone, strict=True):
        assert_same(one, other)
    assert (alone[0].status, alone[1].status, alone[3].status) == ("done", "tripped", "done")
    assert alone[1].trip is not None and alone[1].power_off_tick and not alone[1].idle
    # a fault is seen, and nothing of it is left in the run after the next one
    assert repr(alone[0].numbers) == repr(alone[3].numbers) != repr(alone[1].numbers)


def test_runs_that_can_share_no_past_are_timed_like_others_from_the_start():
    experiments = broken(begun(drive="modelica_dc"), (ALIVE, ALIVE))
    with Runs(KEPT._replace(timed=True), most=2) as runs:
        assert all(runs.run(experiment).costs for experiment in experiments)
        assert lacking(runs) != [] and "" not in lacking(runs)


def test_a_run_whose_component_fails_has_its_bits_and_leaves_nothing_behind():
    unwatched = replace(begun(), monitor=None)
    experiments = broken(unwatched, (ALIVE, WILD, ALIVE)) + broken(begun(), (WILD, ALIVE))
    alone = from_the_start(experiments)
    for one, other in zip(outcomes(experiments), alone, strict=True):
        assert_same(one, other)
    assert [outcome.status for outcome in alone] == ["done", "failed", "done", "tripped", "done"]


def test_a_failed_run_has_its_trace_and_no_numbers_and_raises_only_if_it_had_to_be_completed():
    (outcome,) = from_the_start([replace(begun(), faults=(WILD,), monitor=None)])
    assert (outcome.status, outcome.numbers) == ("failed", None) and outcome.culprit
    assert outcome.trace is not None and ONSET < len(outcome.trace.t) < TICKS
    with pytest.raises(ComponentFailed) as raised:
        outcome.require_success()
    assert raised.value is outcome.failure


def test_only_what_is_requested_is_kept():
    (nothing,) = from_the_start([begun()], RunRequest())
    assert (nothing.trace, nothing.numbers, nothing.idle, nothing.status) == (None, None, True, "done")
    (force,) = from_the_start([begun()], RunRequest(frozenset({"plant.F_ee_B"})))
    assert force.trace is not None and {*force.trace.fields()} == {"plant.F_ee_B"}
    with Runs(RunRequest(signals=None)) as runs:
        (faulty,) = broken(begun(), (ALIVE,))
        every = runs.run(faulty).trace
        # a past has no signals of the fault
        assert every is not None and "fault/1.count_l" in every.fields() and runs._pasts == []


def test_an_experiment_is_checked_before_its_first_tick():
    checked: list[tuple[Experiment, bool]] = []

    def check(experiment: Experiment, system: System) -> None:
        checked.append((experiment, system.has_output("plant.F_ee_B")))
        if experiment.faults == (MOVED,):
            raise InputRefused("cannot be measured")

    first, second = broken(begun(), (ALIVE, MOVED))
    with Runs(RunRequest(tally=True, check=check)) as runs:
        runs.run(first)
        with pytest.raises(InputRefused, match="cannot be measured"):
            runs.run(second)
        runs.run(first)
    assert checked.count((first, True)) == 2 and (second, True) in checked


def test_a_past_is_run_once_after_so_many_runs_that_have_it(monkeypatch: pytest.MonkeyPatch):
    pasts: list[Experiment] = []
    make = SharedPrefix._make

    def counted(self: SharedPrefix, *observers: object) -> None:
        pasts.append(self.experiment)
        make(self, *observers)  # type: ignore[arg-type]

    monkeypatch.setattr(SharedPrefix, "_make", counted)
    with Runs(RunRequest(tally=True), after=2) as runs:
        for number, experiment in enumerate(broken(begun(), (ALIVE,) * 5)):
            runs.run(experiment)
            assert len(pasts) == (number >= 2)
        # names and values make no other run, the seed does only where there is noise
        runs.run(replace(begun(), name="other", title="other", seed=9, values={}))
        assert len(pasts) == 1 and len(runs._pasts) == 1


def test_another_seed_of_the_noise_is_another_past():
    noisy = [begun("plant.motor_noise_deg=0.001", f"seed={seed}") for seed in (0, 1)]
    experiments = [one for experiment in noisy for one in broken(experiment, (ALIVE, ALIVE))]
    with Runs(KEPT) as runs:
        found = [runs.run(experiment) for experiment in experiments]
        assert lacking(runs) == ["", ""]
    for one, other in zip(found, from_the_start(experiments), strict=True):
        assert_same(one, other)
    assert repr(found[0].numbers) != repr(found[2].numbers)


def test_the_past_that_was_used_longest_ago_is_freed_beyond_the_most(monkeypatch: pytest.MonkeyPatch):
    freed: list[Experiment] = []
    free = runs_module._free

    def noted(past: runs_module._PrefixEntry) -> None:
        freed.append(past.key)
        free(past)

    monkeypatch.setattr(runs_module, "_free", noted)
    soft, usual, hard = (begun(f"contact.stiffness_N_per_m={K}") for K in (500, 1000, 2000))
    with Runs(RunRequest(tally=True), most=2) as runs:
        for experiment in (soft, usual, soft, hard):
            runs.run(experiment)
        keys = [past.key for past in runs._pasts]
        assert len(keys) == 2 and len(freed) == 1
        assert freed[0].contact == usual.contact and [key.contact for key in keys] == [soft.contact, hard.contact]
    assert len(freed) == 3 and runs._pasts == []


def test_several_faults_share_a_past_and_have_the_bits_of_runs_from_the_start():
    experiments = [replace(begun(), faults=faults) for faults in ((MOVED, ALIVE), (ALIVE, MOVED), (MOVED, RUNAWAY))]
    for one, other in zip(outcomes(experiments), from_the_start(experiments), strict=True):
        assert_same(one, other)


def test_of_several_faults_with_an_idle_shaft_no_past_is_known():
    two = replace(begun("cosim.scheme=jacobi"), faults=(RUNAWAY, ALIVE))
    with Runs(KEPT) as runs:
        (alone,) = from_the_start([two])
        assert_same(runs.run(two), alone)
        assert runs._pasts == []
