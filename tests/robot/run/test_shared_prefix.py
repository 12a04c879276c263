"""Runs that go on from the past of another one: the bits of a run from the start, and nothing of one in the next."""

import math
from collections.abc import Callable
from contextlib import closing
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from tests.laws.runs import EXPERIMENTS, FORCE, shipped
from twin.kernel.cosim.port import width
from twin.kernel.cosim.simulation import Simulation
from twin.kernel.cosim.system import System
from twin.kernel.fmi.component import FmuStates
from twin.robot.assembly.assemble import assemble
from twin.robot.assembly.load import load_experiment
from twin.robot.controller.task_controller import set_hold_point
from twin.robot.experiment.experiment import Experiment
from twin.robot.experiment.fault import Fault
from twin.robot.experiment.schema import WayPoints
from twin.robot.faults import FaultComponent, MessageFault
from twin.robot.run.runs import RunRequest, Runs
from twin.robot.run.shared_prefix import (
    MAX_STATES,
    SharedPrefix,
    prefix_experiment,
    simulate_variants,
)
from twin.robot.run.trace import Trace, run_in_memory
from twin.robot.shaft import DriveFault

TICKS = 6500
ONSET = 54 * math.ceil((TICKS + 1) / MAX_STATES)
"""A tick of which a state is kept: what comes in there acts at once."""
GLITCH = Fault("encoder_glitch", "joint_encoder_2", ONSET, magnitude=0.01, share=0.02, seed=3)
RUNAWAY = Fault("drive_runaway", "drive_2", ONSET, magnitude=2.0)
SOFT = Fault("spring_softened", "joint_2", ONSET, magnitude=0.4, ramp=50)
JUMP = Fault("surface_jump", "contact", ONSET, magnitude=5e-3)
LATE = Fault("sample_jitter", "encoder", ONSET, magnitude=10e-3)


def gone_on(past: SharedPrefix, experiment: Experiment, tick: int = ONSET, before: Trace | None = None) -> Trace:
    """From the state before `tick`; with the rows `before`, or none of them."""
    trace = Trace(past=before) if before else Trace()
    assert past.make_ready()
    past.run_variant(experiment, tick, [trace])
    return trace


def assert_ends_alike(part: Trace, whole: Trace) -> None:
    """`part` may lack the first rows."""
    assert set(part.fields()) == set(whole.fields()) and 0 < len(part.t) <= len(whole.t)
    for key in whole.fields():
        values, all_values = part.held(key), whole.held(key)
        # how fast the shaft of a drive that will break turned in the step before is not known to the state
        late = 1 if key == "fault/1.omega_m" else 0
        kept = values[late:]
        np.testing.assert_array_equal(kept, all_values[len(all_values) - len(kept) :], err_msg=key)


def pressing(seconds: float, *overrides: str) -> Experiment:
    """The first `seconds` of it."""
    return replace(shipped("pressing", *overrides), duration_ticks=round(1e3 * seconds))


def with_fault(experiment: Experiment, fault: Fault) -> Experiment:
    return replace(experiment, faults=(fault,))


@pytest.mark.parametrize("fault", [GLITCH, RUNAWAY, SOFT, JUMP, LATE], ids=lambda fault: fault.kind)
@pytest.mark.parametrize(
    "settings",
    [(), ("cosim.scheme=jacobi",), ("cosim.inputs=linear", "cosim.iterations=2")],
    ids=["usual", "jacobi", "iterated"],
)
def test_every_signal_of_a_fault_has_the_bits_of_a_run_from_the_start(settings: tuple[str, ...], fault: Fault):
    experiment = with_fault(pressing(6.5, *settings), fault)
    with closing(SharedPrefix(prefix_experiment(experiment))) as past:
        assert not past.lacking
        assert_ends_alike(gone_on(past, experiment), run_in_memory(experiment))


def test_nothing_of_a_run_is_left_in_the_next_one():
    changing = 'change=[{t_s = 3.0, key = "controller.force.ki_mm_per_N_s", value = 9.0}]'
    base = pressing(6.5, changing)
    trace = Trace()
    with closing(SharedPrefix(base, [trace])) as past:
        for fault in (SOFT, GLITCH, Fault("belief_k_s", "estimator", 2000, magnitude=1.2), RUNAWAY, SOFT):
            one = with_fault(base, fault)
            assert_ends_alike(gone_on(past, one, fault.onset), run_in_memory(one))
        again = gone_on(past, base, 0, before=trace)
        np.testing.assert_array_equal(again.values, trace.values)


def assert_runs_as_from_the_start(experiment: Experiment) -> None:
    """`Runs` asks for a past, has none to share, and gives the numbers of a run from the start."""
    whole = run_in_memory(experiment)
    with Runs(RunRequest(signals=frozenset(whole.fields()))) as runs:
        found = runs.run(experiment).trace
        assert [past.shared is not None and past.shared.lacking != "" for past in runs._pasts] == [True]
    assert found is not None
    np.testing.assert_array_equal(found.values, whole.values)


def test_a_change_that_acts_later_goes_on_from_the_run_without_it():
    base = pressing(6.5)
    later = pressing(6.5, 'change=[{t_s = 5.508, key = "controller.force.ki_mm_per_N_s", value = 9.0}]')
    with closing(SharedPrefix(base)) as past:
        assert_ends_alike(gone_on(past, later), run_in_memory(later))


def test_rows_before_the_state_are_those_of_the_past():
    base = pressing(6.5)
    before = Trace(only=("plant.F_ee_B", "plant.p_B"))
    with closing(SharedPrefix(base, [before])) as past:
        trace = Trace(only=("plant.F_ee_B", "plant.p_B"), past=before)
        past.run_variant(with_fault(base, SOFT), ONSET, [trace])
    whole = run_in_memory(with_fault(base, SOFT))
    np.testing.assert_array_equal(trace["plant.F_ee_B"], whole["plant.F_ee_B"])
    np.testing.assert_array_equal(trace.t, whole.t)


def test_without_a_state_it_is_said_and_runs_are_made_from_the_start():
    base = load_experiment(EXPERIMENTS / "pressing.toml", (), "modelica_dc")
    base = replace(base, duration_ticks=300)
    with closing(SharedPrefix(base)) as past:
        assert "modelica_dc.fmu (drive_1) has no FMU state" in past.lacking and not past.make_ready()
    assert_runs_as_from_the_start(with_fault(base, Fault("drive_dead", "drive_1", 200)))


def test_an_fmu_that_does_not_restore_what_it_says_is_found_and_shares_nothing(monkeypatch: pytest.MonkeyPatch):
    monkeypatch.setattr(FmuStates, "restore_state", lambda self, token: None)
    base = pressing(6.5)
    with closing(SharedPrefix(base)) as past:
        assert past.lacking == "a component does not reproduce its numbers from a saved state"
        assert not past.make_ready()
    assert_runs_as_from_the_start(base)


def test_states_are_few_and_freed(monkeypatch: pytest.MonkeyPatch):
    held: list[int] = []
    take, free = FmuStates.save_state, FmuStates.free

    def taken(self: FmuStates) -> int:
        held.append(1)
        return take(self)

    def freed(self: FmuStates, token: int) -> None:
        held.append(-1 if token in self._tokens else 0)
        free(self, token)

    monkeypatch.setattr(FmuStates, "save_state", taken)
    monkeypatch.setattr(FmuStates, "free", freed)
    with closing(SharedPrefix(pressing(2))) as past:
        assert sum(held) <= 3 * MAX_STATES
        for _ in range(5):
            gone_on(past, with_fault(pressing(2), Fault("drive_dead", "drive_1", 900)), 900)
        assert sum(held) <= 3 * MAX_STATES
    assert sum(held) == 0


def test_a_state_that_is_handed_over_a_tick_late_is_seen(monkeypatch: pytest.MonkeyPatch):
    take_over = Simulation.copy_from

    def late(self: Simulation, other: Simulation) -> list[str]:
        new = take_over(self, other)
        self.next_tick += 1
        return new

    monkeypatch.setattr(Simulation, "copy_from", late)
    experiment = with_fault(pressing(6.5), SOFT)
    with closing(SharedPrefix(prefix_experiment(experiment))) as past, pytest.raises(AssertionError):
        assert_ends_alike(gone_on(past, experiment), run_in_memory(experiment))


@pytest.mark.parametrize(
    ("fault", "kind", "left_out"),
    [(GLITCH, FaultComponent, "join_run"), (RUNAWAY, DriveFault, "idle_outputs"), (LATE, MessageFault, "idle_outputs")],
)
def test_a_fault_that_does_not_come_in_as_if_it_had_been_there_is_seen(
    monkeypatch: pytest.MonkeyPatch, fault: Fault, kind: type, left_out: str
):
    idle = {"join_run": lambda self, tick: None, "idle_outputs": lambda self, given: np.zeros(width(self.outputs))}
    monkeypatch.setattr(kind, left_out, idle[left_out])
    experiment = with_fault(pressing(6.5), fault)
    with closing(SharedPrefix(prefix_experiment(experiment))) as past, pytest.raises(AssertionError):
        assert_ends_alike(gone_on(past, experiment), run_in_memory(experiment))


FRAGILE = """
from my_controller import Controller

class Fragile(Controller):
    calls = 0

    def step(self, t, inputs):
        self.calls += 1
        if max(abs(self.force)) > 3.0:
            raise ValueError("too much")
        return super().step(t, inputs)

    def state(self):
        return {"force": self.force, "calls": self.calls}

    def restore(self, state):
        self.force, self.calls = state["force"].copy(), state["calls"]
"""


def test_where_a_part_has_failed_all_is_made_anew(root: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch):
    monkeypatch.syspath_prepend(root / "examples")
    (tmp_path / "fragile.py").write_text(FRAGILE)
    base = shipped(FORCE, f"controller.python={tmp_path}/fragile.py:Fragile")
    base = replace(base, duration_ticks=500)
    felt, unfelt = (Fault("encoder_bias", "joint_encoder_1", 300, magnitude=angle) for angle in (0.3, 0.01))
    with closing(SharedPrefix(base)) as past:
        for _ in range(2):
            trace = Trace(only=("plant.F_ee_B",))
            assert past.make_ready()
            failure = past.run_variant(with_fault(base, felt), 300, [trace]).failure
            assert failure is not None and "too much" in str(failure)
            one = with_fault(base, unfelt)
            assert_ends_alike(gone_on(past, one, 300), run_in_memory(one))


REST, END = 1000, 1600


def raised(system: System) -> None:
    set_hold_point(system, (0.0, 0.02, -0.099))


def lowered(system: System) -> None:
    set_hold_point(system, (0.0, 0.02, -0.101))


def held_up(drive: str) -> Experiment:
    at_start = WayPoints((0.0, 0.998, 1.0), ((0.0, 0.02, -0.1),) * 3)
    return replace(load_experiment(EXPERIMENTS / "fig4_position.toml", (), drive), reference=at_start)


def test_runs_that_fork_are_alike_until_they_are_changed():
    def forks(*ways: Callable[[System], None]) -> list[Trace]:
        experiment = held_up("velocity_servo")
        return simulate_variants(lambda: assemble(experiment), REST, END, ["plant.p_B"], ways)

    up, down, again = (one["plant.p_B"] for one in forks(raised, lowered, raised))
    np.testing.assert_array_equal(up, again)
    np.testing.assert_array_equal(up[: REST + 1], down[: REST + 1])
    assert up[-1, 2] - down[-1, 2] > 1e-3
