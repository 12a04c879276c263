"""The events of a run: triggers, phases of tasks, trips, faults, messages of FMUs.

What a run takes in time and on the disk, before it begins.

Viewers of a running simulation: the interface that a run calls.
"""

import math
import threading
from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from typing import Any, NamedTuple, Protocol

import numpy as np

from twin.kernel.cosim.deadlines import Deadlines, clock_functions
from twin.kernel.cosim.observers import Observer, TickEvent, messages
from twin.kernel.cosim.simulation import Simulation
from twin.kernel.errors import InputRefused
from twin.kernel.process.job import LONG, duration_text
from twin.kernel.recording.recorder import RowStream
from twin.robot.assembly.assemble import Assembly, tunables
from twin.robot.assembly.declared import DECLARED
from twin.robot.controller.program import PhaseKind
from twin.robot.experiment.experiment import Experiment
from twin.robot.experiment.mistakes import unknown
from twin.robot.experiment.schema import changed_value
from twin.robot.monitor.checks import trip_sentence
from twin.robot.monitor.component import other_trip, own_monitor
from twin.robot.run.hold import HoldRequest
from twin.robot.run.outcome import Tally
from twin.robot.scene import Scene


class Tuning(Observer):
    """The parameters of one run that may be changed while it goes on.

    `values`, `request` and `close` may be called from any thread.

    Attributes:
        first: what was changed by hand first, as its event says it; "" as long as nothing was.
    """

    lasting = ("first", "_values")

    def __init__(self, experiment: Experiment, assembly: Assembly):
        self.first = ""
        self._experiment = experiment
        self._tunables = tunables(experiment, assembly.system)
        self._values = {key: float(tunable.number) for key, tunable in self._tunables.items()}
        self._asked: dict[str, tuple[float, float]] = {}
        self._changes: list[TickEvent] = []
        self._open = True
        self._lock = threading.Lock()

    def values(self) -> dict[str, float]:
        """Every parameter that may be changed, by its key in the experiment's file, in the unit of that key.

        What has been asked for counts already.
        """
        with self._lock:
            return self._values | {key: number for key, (number, _) in self._asked.items()}

    def request(self, key: str, number: object) -> None:
        """Ask for `number` (in the unit of the key) from the next slice on.

        Raises:
            InputRefused: no such parameter, a value that the experiment's schema refuses, or the run is over.
        """
        if key not in self._tunables:
            raise InputRefused(f"{unknown(key, list(self._tunables))}; only these can be changed while it runs")
        value = changed_value(DECLARED, key, number, self._experiment.values)
        with self._lock:
            if not self._open:
                raise InputRefused(f"{key} = {number}: the run is over, nothing can be changed any more")
            self._asked[key] = (float(number), value)  # type: ignore[arg-type]

    def restore(self, state: Any) -> None:
        """What was changed by hand before is so again."""
        before = dict(self._values)
        super().restore(state)
        for key, number in self._values.items():
            if key not in before:
                raise InputRefused(f"the state has {key} = {number}, which cannot be changed in this run")
            if number != before[key]:
                self._tunables[key].memory[...] = changed_value(DECLARED, key, number, self._experiment.values)

    def ready(self, tick: int) -> None:
        """Make the changes asked for, so that they act from `tick` on."""
        with self._lock:
            asked, self._asked = self._asked, {}
            for key, (number, value) in asked.items():
                if number != self._values[key]:
                    self._tunables[key].memory[...] = value
                    self._tell(tick, key, number, " (live)")
                    self.first = self.first or self._changes[0].text

    def take(self, first: int, rows: np.ndarray, events: list[TickEvent]) -> None:
        """Tell what was changed by hand before this slice, and by the experiment itself in it."""
        with self._lock:
            for change in self._experiment.changes:
                if first <= change.tick < first + len(rows) and change.key in self._values:
                    self._tell(change.tick, change.key, change.number)
        events += self._changes
        self._changes = []

    def _tell(self, tick: int, key: str, number: float, how: str = "") -> None:
        before, self._values[key] = self._values[key], number
        change = f"{key}: {_written(before)} -> {_written(number)}{how}"
        self._changes.append(TickEvent(tick, "INFO", change, "tuning"))

    def close(self) -> None:
        """Refuse from now on."""
        with self._lock:
            self._open = False


def _written(number: float) -> str:
    """With every digit that it takes to get the same number back."""
    return repr(number).removesuffix(".0")


SECONDS_PER_TICK = 20e-6
"""Stepping and recording with a drive of compiled code; one written in Python takes ten times as long."""
BYTES_PER_TICK = 350
"""Of a recording; the shipped experiments and drives take 300 to 410. Half of it at the controller's rate."""
LARGE = 5e9
"""Size (bytes) beyond which a run starts only after a question."""


def estimate(experiment: Experiment) -> tuple[float, float]:
    """(s, bytes) that a run of `experiment` takes, about."""
    ticks = experiment.duration_ticks
    shortest = experiment.controller_ticks if experiment.recording.rate == "controller" else 1
    return ticks * SECONDS_PER_TICK, ticks / shortest * BYTES_PER_TICK


def refuse_endless(experiments: Sequence[Experiment], factor: float | None = None) -> None:
    """Ask the user whether runs that take very long or fill the disk are meant.

    Args:
        experiments: to be run one after the other.
        factor: simulated time per wall time; None or 0: as fast as it goes.

    Raises:
        InputRefused: more than `LONG` or `LARGE`; it says how much.
    """
    costs = [estimate(experiment) for experiment in experiments]
    seconds, size = (sum(cost[i] for cost in costs) for i in (0, 1))
    if factor:
        seconds = max(seconds, sum(one.duration_ticks * one.cosim.tick for one in experiments) / factor)
    if seconds <= LONG and size <= LARGE:
        return
    raise InputRefused(
        f"{', '.join(experiment.name for experiment in experiments)}: would take about "
        f"{duration_text(seconds)} and {size / 1e9:,.0f} GB; --yes runs it anyway, --set duration_s=... shortens it"
    )


PRESSING = (PhaseKind.BUILD_UP, PhaseKind.HOLD, PhaseKind.CIRCLE, PhaseKind.PUSH)
UNREACHED = "did not reach the force down to the floor of the approach"
CUT_SHORT = {
    PhaseKind.DESCEND: "felt nothing down to the floor of the approach",
    PhaseKind.PROBE: UNREACHED,
    PhaseKind.TAP: UNREACHED,
    **dict.fromkeys(PRESSING, "lost contact"),
}
"""What it means if a phase is followed by the retraction that is not its turn."""


class Watch(Observer):
    """Finds the events of a run in its rows, slice by slice."""

    lasting = ("_before", "_touched", "_early", "_tripped", "_power")

    def __init__(self, assembly: Assembly, experiment: Experiment):
        self._system = assembly.system
        self._experiment = experiment
        self._tasks = [type(task).__name__.lower() for task in experiment.tasks]
        names = (
            *(("controller.task", "controller.phase") if self._tasks else ("controller.triggered",)),
            "controller.F_z",
        )
        # a third-party one need not tell
        known = all(assembly.system.has(name) for name in names)
        self._watched = [assembly.system.columns(name).start for name in names] if known else []
        self._before = np.zeros(len(names) - 1)
        of_touch = ("plant.F_ee_B", "controller.triggered")
        self._of_touch = (
            [assembly.system.columns(of_touch[0]).start + 2, assembly.system.columns(of_touch[1]).start]
            if all(assembly.system.has(name) for name in of_touch)
            else []
        )
        self._touched, self._early = False, -1
        self._monitor = own_monitor(assembly.system)
        self._tripped, self._power = False, True

    def take(self, first: int, rows: np.ndarray, events: list[TickEvent]) -> None:
        if len(rows):
            events += [
                *self._faults(first, len(rows)),
                *self._progress(first, rows),
                *self._false_trigger(first, rows),
                *self._trips(first, rows),
                *messages(self._system),
            ]
            events.sort(key=lambda event: event.tick)

    def _progress(self, first: int, rows: np.ndarray) -> Iterator[TickEvent]:
        if not self._watched:
            return
        *columns, pressing = self._watched
        watched = np.concatenate([self._before[None, :], rows[:, columns]])
        self._before = watched[-1]
        for k in np.flatnonzero((watched[1:] != watched[:-1]).any(axis=1)):
            before, after, tick = watched[k], watched[k + 1], first + int(k)
            F_z = rows[k, pressing]
            if self._tasks:
                yield from self._phase(tick, before, after, F_z)
            elif after[0] > before[0]:
                yield TickEvent(tick, "INFO", f"force control triggered at F_z = {F_z:.3f} N", "controller")

    def _false_trigger(self, first: int, rows: np.ndarray) -> Iterator[TickEvent]:
        """A force loop that is on before the robot truly touches: it controls the force of air."""
        if self._touched or not self._of_touch:
            return
        F_ee_z, on = rows[:, self._of_touch].T
        touching = np.flatnonzero(F_ee_z < 0.0)
        touch = int(touching[0]) if len(touching) else len(rows)
        triggered = np.flatnonzero(on[:touch])
        if self._early < 0 and len(triggered):
            self._early = first + int(triggered[0])
            yield TickEvent(self._early, "WARNING", "the force loop is on before the first touch", "controller")
        self._touched = len(touching) > 0
        if self._touched and self._early >= 0:
            lead = (first + touch - self._early) * self._system.tick
            text = f"first touch: the force loop was triggered {lead:.3f} s before it"
            yield TickEvent(first + touch, "WARNING", text, "controller")

    def _phase(self, tick: int, before: np.ndarray, after: np.ndarray, F_z: float) -> Iterator[TickEvent]:
        number, phase = int(after[0]), PhaseKind(int(after[1]))
        name = f"task {number} ({self._tasks[number - 1]})"
        if before[0] != number:
            yield TickEvent(tick, "INFO", f"{name} of {len(self._tasks)} begins", "controller")
        was = PhaseKind(int(before[1])) if before[1] else PhaseKind.DONE
        # a probe is followed by a retraction either way; what tells them apart is the force
        felt = was is PhaseKind.PROBE and F_z >= self._experiment.tasks[number - 1].force
        if phase is PhaseKind.RETRACT and was in CUT_SHORT and not felt:
            yield TickEvent(tick, "WARNING", f"{name} {CUT_SHORT[was]}", "controller")
        yield TickEvent(tick, "DEBUG", f"{name}: {phase.phrase}", "controller")

    def _trips(self, first: int, rows: np.ndarray) -> Iterator[TickEvent]:
        if self._monitor is None:
            yield from self._other_trip(first, rows)
            return
        trip = self._monitor.trip
        if trip is not None and not self._tripped:
            self._tripped = True
            yield TickEvent(trip.tick, "ERROR", trip_sentence(trip), "monitor")
        off = self._monitor.power_off_tick
        if off is not None and self._power:
            self._power = False
            yield TickEvent(off, "ERROR", "safety monitor: the motors do not retract; power taken away", "monitor")

    def _other_trip(self, first: int, rows: np.ndarray) -> Iterator[TickEvent]:
        """That of a third-party monitor, of which it is known only that."""
        if self._tripped or not self._system.has("monitor.tripped"):
            return
        at = np.flatnonzero(rows[:, self._system.columns("monitor.tripped").start])
        if len(at):
            self._tripped = True
            yield TickEvent(first + int(at[0]), "ERROR", other_trip(self._system.component("monitor")), "monitor")

    def _faults(self, first: int, count: int) -> Iterator[TickEvent]:
        for number, fault in enumerate(self._experiment.faults, start=1):
            name = f"fault {number} ({fault.kind} of {fault.target})"
            for tick, verb in ((fault.onset, "begins"), (fault.end, "ends")):
                if first <= tick < first + count:
                    yield TickEvent(tick, "WARNING", f"{name} {verb}", f"fault_{number}")


class RunObservers(NamedTuple):
    """The observers of every run that have a state; with its recorder they are what a saved state holds, by name.

    Attributes:
        tuning: changes by hand.
        watch: the monitor's and the tasks' events.
        tally: the outcome, and the pressing force of each task.
    """

    tuning: Tuning
    watch: Watch
    tally: Tally


def run_observers(experiment: Experiment, assembly: Assembly) -> RunObservers:
    """New observers of a run of `experiment`, which `assembly` was made of."""
    system = assembly.system
    tally = Tally(system, HoldRequest.of(experiment))
    return RunObservers(Tuning(experiment, assembly), Watch(assembly, experiment), tally)


class Viewer(Protocol):
    """Called by the thread that steps, between slices; what it takes its time over delays the run."""

    def begin(self, streams: Sequence[RowStream], scene: Scene, tick: float, tuning: Tuning) -> None:
        """A run begins as soon as this returns.

        Args:
            streams: in the order of the recording.
            scene: draws rows.
            tick: duration of a tick (s).
            tuning: what may be changed, by any thread, until the run is over.
        """

    def show(self, first: int, rows: np.ndarray, events: Sequence[TickEvent]) -> None:
        """Show what has just been simulated.

        Args:
            first: tick of the first row.
            rows: (n, width of the system's outputs), overwritten by the next slice.
            events: what happened in them.
        """


class Shown(Observer):
    """Shows a run to `viewer`; the arguments are those of its `begin`."""

    def __init__(self, viewer: Viewer, streams: Sequence[RowStream], scene: Scene, tuning: Tuning):
        self._viewer, self._streams, self._scene, self._tuning = viewer, streams, scene, tuning

    def begin(self, simulation: Simulation) -> None:
        self._viewer.begin(self._streams, self._scene, simulation.system.tick, self._tuning)

    def take(self, first: int, rows: np.ndarray, events: list[TickEvent]) -> None:
        self._viewer.show(first, rows, events)


SLICE = 0.01
"""Wall time (s) of a slice of a paced run: short for a user who turns a knob, long compared with what it costs."""


@dataclass(frozen=True)
class Punctuality:
    """How a paced run kept its deadlines.

    Attributes:
        factor: simulated time per wall time that was wanted.
        achieved: what it came to.
        deadlines: how many there were.
        misses: at how many the work was not done yet.
        worst: longest time by which one was missed (s).
        jitter, jitter_99: standard deviation and 99th percentile of the time from a deadline to going on (s).
    """

    factor: float
    achieved: float
    deadlines: int
    misses: int
    worst: float
    jitter: float
    jitter_99: float

    @property
    def sentence(self) -> str:
        """For people, less than 80 columns."""
        missed = f"{self.misses} of {self.deadlines} deadlines missed"
        if self.misses:
            missed += f", by {1e3 * self.worst:.1f} ms at most"
        return f"{self.achieved:.4g} x real time; {missed}; jitter {1e3 * self.jitter:.2f} ms"


class Pace(Observer):
    """Lets simulated time pass `factor` times as fast as the clock on the wall, see `Deadlines`.

    Args:
        factor: simulated time per wall time, > 0.
        tick: duration of a tick (s).

    Attributes:
        tick_time: wall time of a tick (s).
        deadlines: of its ticks.
    """

    def __init__(self, factor: float, tick: float):
        self._factor = factor
        self.tick_time = tick / factor
        self.deadlines = Deadlines(self.tick_time, clock_functions())

    def slice_ticks(self, block: int) -> int:
        """Ticks between two looks at what has come: at most `SLICE`, at least one tick, and a divisor of `block`."""
        most = max(1, math.floor(SLICE / self.tick_time + 1e-9))
        return max(n for n in range(1, block + 1) if n <= most and block % n == 0)

    def begin(self, simulation: Simulation) -> None:
        simulation.pace(self.deadlines)

    def punctuality(self) -> Punctuality:
        """Of every deadline so far."""
        found = self.deadlines.counts
        count, mean = max(1, found["count"]), found["sum"] / max(1, found["count"])
        due = (found["last"] - found["start"]) * self.tick_time if found["count"] else 0.0
        return Punctuality(
            factor=self._factor,
            achieved=self._factor * due / (due + found["newest"]) if due else self._factor,
            deadlines=int(found["count"]),
            misses=int(found["missed"]),
            worst=found["worst"],
            jitter=math.sqrt(max(0.0, found["squares"] / count - mean**2)),
            jitter_99=self.deadlines.lateness.quantile(0.99) if found["count"] else 0.0,
        )
