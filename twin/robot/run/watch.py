"""Events of a run: triggers, phases of tasks, trips, faults, messages of FMUs."""

from collections.abc import Iterator
from typing import NamedTuple

import numpy as np

from twin.kernel.cosim.observers import Observer, TickEvent, message_events
from twin.robot.assembly.assemble import Assembly
from twin.robot.controller.program import PhaseKind
from twin.robot.experiment.experiment import Experiment
from twin.robot.monitor.component import other_trip, own_monitor
from twin.robot.monitor.reasons import trip_message
from twin.robot.run.fault_starts import FaultStarts
from twin.robot.run.hold import HoldRequest
from twin.robot.run.outcome import Tally
from twin.robot.run.tuning import Tuning

PRESSING_PHASES = (PhaseKind.BUILD_UP, PhaseKind.HOLD, PhaseKind.CIRCLE, PhaseKind.PUSH)
UNREACHED_TEXT = "did not reach the force down to the floor of the approach"
CUT_SHORT_TEXTS = {
    PhaseKind.DESCEND: "felt nothing down to the floor of the approach",
    PhaseKind.PROBE: UNREACHED_TEXT,
    PhaseKind.TAP: UNREACHED_TEXT,
    **dict.fromkeys(PRESSING_PHASES, "lost contact"),
}
"""Event text by phase, if the phase is cut short by an early retraction."""


class Watch(Observer):
    """Observer that derives the events of a run from its signals: triggers, phases, trips, faults."""

    lasting = ("_before", "_touched", "_early", "_tripped", "_power")

    def __init__(self, assembly: Assembly, experiment: Experiment):
        self._system = assembly.system
        self._experiment = experiment
        self._tasks = [type(task).__name__.lower() for task in experiment.tasks]
        names = (
            *(("controller.task", "controller.phase") if self._tasks else ("controller.triggered",)),
            "controller.F_z",
        )
        self._watched = self._columns(*names)
        self._before = np.zeros(len(names) - 1)
        self._of_touch = self._columns("plant.F_ee_B", "controller.triggered")
        self._touched, self._early = False, -1
        self._monitor = own_monitor(assembly.system)
        self._tripped, self._power = False, True
        self._spans = [(fault.onset, fault.end) for fault in experiment.faults]

    def move_fault(self, index: int, onset: int, end: int) -> None:
        """Set the ticks at which a fault of the experiment begins and ends, other than in its file."""
        self._spans[index] = onset, end

    def _columns(self, *names: str) -> list[int]:
        """Return the first column of each signal; empty if a third-party controller does not report all of them."""
        known = all(map(self._system.has_output, names))
        return [self._system.columns(name).start for name in names] if known else []

    def on_rows(self, first: int, rows: np.ndarray, events: list[TickEvent]) -> None:
        if len(rows):
            events += [
                *self._faults(first, len(rows)),
                *self._progress(first, rows),
                *self._false_trigger(first, rows),
                *self._trips(first, rows),
                *message_events(self._system),
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
        """Yield a warning if the force loop is on before the first true touch, and another at that touch."""
        if self._touched or not self._of_touch:
            return
        F_ee, triggered_column = self._of_touch
        F_ee_z, on = rows[:, F_ee + 2], rows[:, triggered_column]
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
        # a probe always ends in a retraction; the force decides whether it succeeded
        felt = was is PhaseKind.PROBE and F_z >= self._experiment.tasks[number - 1].force
        if phase is PhaseKind.RETRACT and was in CUT_SHORT_TEXTS and not felt:
            yield TickEvent(tick, "WARNING", f"{name} {CUT_SHORT_TEXTS[was]}", "controller")
        yield TickEvent(tick, "DEBUG", f"{name}: {phase.phrase}", "controller")

    def _trips(self, first: int, rows: np.ndarray) -> Iterator[TickEvent]:
        if self._monitor is None:
            yield from self._other_trip(first, rows)
            return
        trip = self._monitor.trip
        if trip is not None and not self._tripped:
            self._tripped = True
            yield TickEvent(trip.tick, "ERROR", trip_message(trip), "monitor")
        off = self._monitor.power_off_tick
        if off is not None and self._power:
            self._power = False
            yield TickEvent(off, "ERROR", "safety monitor: the motors do not retract; power taken away", "monitor")

    def _other_trip(self, first: int, rows: np.ndarray) -> Iterator[TickEvent]:
        """Yield the trip event of a third-party safety monitor, which reports no reason."""
        if self._tripped or not self._system.has_output("monitor.tripped"):
            return
        at = np.flatnonzero(rows[:, self._system.columns("monitor.tripped").start])
        if len(at):
            self._tripped = True
            yield TickEvent(first + int(at[0]), "ERROR", other_trip(self._system.component("monitor")), "monitor")

    def _faults(self, first: int, count: int) -> Iterator[TickEvent]:
        for number, fault in enumerate(self._experiment.faults, start=1):
            name = f"fault {number} ({fault.kind} of {fault.target})"
            for tick, verb in zip(self._spans[number - 1], ("begins", "ends"), strict=True):
                if first <= tick < first + count:
                    yield TickEvent(tick, "WARNING", f"{name} {verb}", f"fault_{number}")


class RunObservers(NamedTuple):
    """The stateful observers of every run: changes by hand, events, outcome; saved states have them by name."""

    tuning: Tuning
    watch: Watch
    tally: Tally


def run_observers(experiment: Experiment, assembly: Assembly) -> RunObservers:
    """Create the stateful observers that every run has."""
    system, watch = assembly.system, Watch(assembly, experiment)
    tally = Tally(system, HoldRequest.from_experiment(experiment))
    starts = FaultStarts(experiment, system, watch.move_fault) if system.has_output("remote.omega_ref") else None
    return RunObservers(Tuning(experiment, assembly, starts), watch, tally)
