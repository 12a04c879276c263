"""The loop: who is called when, with what, and that looking on changes nothing."""

from pathlib import Path
from types import SimpleNamespace
from typing import Any, cast

import numpy as np
import pytest

from tests.laws.runs import FORCE, shipped
from twin.controller.program import TASKS, PhaseKind, Press, Tap
from twin.cosim.simulation import Simulation
from twin.experiment.task import checked_tasks
from twin.recording.reader import read
from twin.runs.assembly.assemble import FORCE_REFERENCE, Assembly, assemble, tunables
from twin.runs.assembly.load import load_experiment
from twin.runs.loop import SIGNALS, Held, HeldForce, Observer, Simulated, TickEvent, simulate
from twin.runs.outcome import Tally
from twin.runs.run import execute
from twin.runs.trace import Trace, run_in_memory
from twin.runs.tuning import Tuning
from twin.runs.watch import Watch
from twin.studies.paper.fig5_measures import task_runs

PRESS = {"kind": "press", "point_mm": (0.0, 0.0), "force_N": 8.0, "build_up_s": 1.0, "hold_s": 5.0}
TAP = {
    "kind": "tap", "point_mm": (0.0, 0.0), "force_N": 3.0, "speed_mm_per_s": 50.0, "lift_mm": 2.0, "period_s": 0.5,
    "times": 3,
}  # fmt: skip
SYSTEM = SimpleNamespace(
    tick=0.001,
    has=lambda name: True,
    columns=lambda name: {"plant.F_ee_B": slice(0, 3), "controller.task": slice(3, 4)}.get(name, slice(4, 5)),
)


def tasks(*tables: dict[str, Any]) -> tuple[Press | Tap, ...]:
    return cast(tuple[Press | Tap, ...], tuple(checked_tasks(TASKS, tables, []).values()))


def rows(*spans: tuple[int, PhaseKind, list[float]]) -> np.ndarray:
    """Rows of spans: a task, its phase, the pressing force at each tick."""
    return np.array([(0.0, 0.0, -F_z, task, phase) for task, phase, force in spans for F_z in force])


def held(table: np.ndarray, size: int, *asked: dict[str, Any]) -> tuple[Held, ...]:
    observer = HeldForce(cast(Any, SYSTEM), tasks(*asked))
    for first in range(0, len(table), size):
        observer.take(first, table[first : first + size], [])
    return observer.held


@pytest.mark.parametrize("size", [1, 3, 100])
def test_the_force_is_that_of_the_phases_that_hold_it_however_rows_are_sliced(size: int):
    table = rows(
        (1, PhaseKind.BUILD_UP, [1.0, 9.0]),
        (1, PhaseKind.HOLD, [7.9, 8.0, 8.1]),
        (1, PhaseKind.RELEASE, [0.0]),
        (2, PhaseKind.PROBE, [5.0]),
        (2, PhaseKind.TAP, [0.0, 2.0]),
        (2, PhaseKind.RISE, [2.9, 0.0]),
        (2, PhaseKind.TAP, [0.0, 3.1]),
        (2, PhaseKind.RISE, [0.5]),
    )
    assert held(table, size, PRESS, TAP, PRESS) == (
        Held(1, "press", 8.0, 0, 7.9, 8.1, 0.002, 0.004),
        # the force of the first touch is none of a tap; a tap's peak may come while it rises
        Held(2, "tap", 3.0, 2, 2.9, 3.1, 0.007, 0.012),
        Held(3, "press", 8.0),
    )


def test_without_tasks_or_a_controller_that_names_them_nothing_is_said():
    assert held(rows((1, PhaseKind.HOLD, [1.0])), 1) == ()
    silent = SimpleNamespace(tick=0.001, has=lambda name: name != SIGNALS[1], columns=SYSTEM.columns)
    assert HeldForce(cast(Any, silent), tasks(PRESS)).held == ()


def test_a_run_says_of_its_taps_what_its_recording_holds(root: Path, tmp_path: Path):
    run = execute(load_experiment(root / "experiments/tapping.toml", []), tmp_path)
    recorded = task_runs(read(run.recording))
    assert [one.taps for one in run.held] == [len(task.taps) for task in recorded] == [10, 10]
    for one, task in zip(run.held, recorded, strict=True):
        assert (one.least, one.largest) == (task.peaks.min(), task.peaks.max())


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

    def take(self, first: int, rows: np.ndarray, events: list[TickEvent]) -> None:
        self.called.append(("take", first))
        self.rows.append(rows.copy())
        self.enough = first + len(rows) >= self._until


def looked_on(*observers: Observer, slice_ticks: int = 100, timed: bool = False) -> Simulated:
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
        observers = [Tuning(experiment, assembly), Watch(assembly, experiment), Tally(system), run, Diary()]
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
        self._memory = tunables(shipped(FORCE), assembly.system)[FORCE_REFERENCE].memory
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

        def take(self, first: int, rows: np.ndarray, events: list[TickEvent]) -> None:
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
