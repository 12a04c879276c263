"""The loop: who is called when, with what, and that looking on changes nothing."""

from pathlib import Path

import numpy as np
import pytest

from tests.laws.runs import FORCE, shipped
from twin.kernel.cosim.observers import Observer, SimulationResult, TickEvent, simulate
from twin.kernel.cosim.simulation import Simulation
from twin.kernel.recording.reader import read
from twin.robot.assembly.assemble import FORCE_REFERENCE, Assembly, assemble, tunable_parameters
from twin.robot.run.hold import HoldRequest
from twin.robot.run.outcome import Tally
from twin.robot.run.run import execute
from twin.robot.run.trace import Trace, run_in_memory
from twin.robot.run.tuning import Tuning
from twin.robot.run.watch import Watch

TOUCHING = ("duration_s=1", "contact.height_mm=-85.5")
"""A scale so high that contact begins soon."""
LAST = 1000


class Diary(Observer):
    """Writes down what it is told."""

    def __init__(self, until: int = LAST + 1):
        self.called: list[tuple[str, int]] = []
        self.rows: list[np.ndarray] = []
        self._until = until

    def begin(self, simulation: Simulation) -> None:
        self.called.append(("begin", simulation.next_tick))

    def ready(self, tick: int) -> None:
        self.called.append(("ready", tick))

    def on_rows(self, first: int, rows: np.ndarray, events: list[TickEvent]) -> None:
        self.called.append(("take", first))
        self.rows.append(rows.copy())
        self.enough = first + len(rows) >= self._until


def looked_on(*observers: Observer, slice_ticks: int = 100, timed: bool = False) -> SimulationResult:
    with assemble(shipped(FORCE, *TOUCHING)) as assembly:
        return simulate(assembly, LAST, observers, slice_ticks, timed)


def test_an_observer_is_told_of_each_slice_before_and_after_it():
    diary = Diary()
    looked_on(diary, slice_ticks=300)
    slices = [(name, first) for first in (0, 300, 600, 900) for name in ("ready", "take")]
    assert diary.called == [("begin", 0), *slices]
    assert [len(rows) for rows in diary.rows] == [300, 300, 300, 101]


@pytest.mark.parametrize("slice_ticks", [7, 100, 5000])
def test_what_an_observer_gets_in_slices_is_what_the_recording_holds(tmp_path: Path, slice_ticks: int):
    diary, run, thirds = Diary(), Trace(), Trace(every=3)
    looked_on(diary, run, thirds, slice_ticks=slice_ticks)
    recording = read(execute(shipped(FORCE, *TOUCHING), tmp_path).recording)
    assert np.concatenate(diary.rows).tobytes() == run.values.tobytes()
    np.testing.assert_array_equal(thirds.values, run.values[::3], strict=True)
    for key in recording.fields():
        np.testing.assert_array_equal(run[key], recording[key], strict=True)


def test_observers_do_not_change_a_bit():
    experiment, run = shipped(FORCE, *TOUCHING), Trace()
    with assemble(experiment) as assembly:
        system = assembly.system
        tally = Tally(system, HoldRequest.from_experiment(experiment))
        observers = [Tuning(experiment, assembly), Watch(assembly, experiment), tally, run, Diary()]
        simulate(assembly, LAST, observers, slice_ticks=50, timed=True)
    assert run.values.tobytes() == run_in_memory(experiment).values.tobytes()


def test_a_run_ends_after_the_slice_in_which_an_observer_has_seen_enough():
    diary, run = Diary(until=250), Trace()
    done = looked_on(diary, run)
    assert len(run.t) == done.simulation.next_tick == 300
    assert done.failure is None
    assert len(run_in_memory(shipped(FORCE, *TOUCHING)).t) == LAST + 1


class Turn(Observer):
    """Writes `value` into the controller's reference of the force before tick `at`."""

    def __init__(self, assembly: Assembly, at: int, value: float):
        self._memory = tunable_parameters(shipped(FORCE), assembly.system)[FORCE_REFERENCE].memory
        self._at, self._value = at, value

    def ready(self, tick: int) -> None:
        if tick == self._at:
            self._memory[...] = self._value


def test_what_is_written_between_two_slices_acts_like_a_change_of_the_experiment_at_that_tick():
    run = Trace()
    with assemble(shipped(FORCE, *TOUCHING)) as assembly:
        simulate(assembly, LAST, [Turn(assembly, 700, 6.0), run], slice_ticks=100)
    change = f"change=[{{t_s = 0.7, key = '{FORCE_REFERENCE}', value = 6.0}}]"
    assert run.values.tobytes() == run_in_memory(shipped(FORCE, *TOUCHING, change)).values.tobytes()
    assert set(run["controller.F_z_ref"]) == {5.0, 6.0}


def test_an_observer_sees_the_events_that_those_before_it_found():
    class Last(Observer):
        def __init__(self) -> None:
            self.events: list[TickEvent] = []

        def on_rows(self, first: int, rows: np.ndarray, events: list[TickEvent]) -> None:
            self.events += events

    change = f"change=[{{t_s = 0.734, key = '{FORCE_REFERENCE}', value = 6.0}}]"
    fault = "fault=[{kind='breathing', onset_s=0.733, duration_s=0.002, magnitude_mm=0.5}]"
    experiment, last = shipped(FORCE, *TOUCHING, change, fault), Last()
    with assemble(experiment) as assembly:
        simulate(assembly, 800, [Tuning(experiment, assembly), Watch(assembly, experiment), last])
    told = [(event.tick, event.source) for event in last.events if event.tick > 700]
    assert told == [(733, "fault_1"), (734, "tuning"), (735, "fault_1")]


def test_the_parts_of_a_timed_run_add_up_to_the_whole_and_an_untimed_one_has_none():
    done = looked_on(timed=True)
    assert set(done.costs) == {component.name for component in done.simulation.system.components}
    # sums of a dozen floats; the master's own time is spread over the components
    assert sum(done.costs.values()) * (LAST + 1) == pytest.approx(done.stepping, rel=1e-9)
    assert looked_on().costs == {}
