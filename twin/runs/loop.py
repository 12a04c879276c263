"""The one loop: an assembled robot, stepped slice by slice before its observers.

Whoever looks on while the robot is simulated, and what is told of what happens.

What the pressing force was while a task held it: of each task, from the rows of a run as it goes.
"""

import time
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from itertools import pairwise
from typing import Literal, NamedTuple, Protocol, Self

import numpy as np
from numpy.typing import NDArray

from twin.controller.program import PhaseKind
from twin.cosim.component import Component
from twin.cosim.port import by_port
from twin.cosim.simulation import Simulation
from twin.cosim.system import System
from twin.errors import ComponentFailed
from twin.experiment.task import Tap, Task
from twin.monitor.checks import trip_sentence
from twin.monitor.component import SafetyMonitor

Level = Literal["DEBUG", "INFO", "WARNING", "ERROR"]


class TickEvent(NamedTuple):
    """Something that happened at a tick: how much it matters, what, and in which component."""

    tick: int
    level: Level
    text: str
    source: str


class Observer:
    """Sees a simulation slice by slice. By itself it does nothing: a kind of observer overrides what it needs.

    The thread that steps calls all observers of a simulation in their order, between slices: what they take their time
    over delays the run. None may write into rows.

    Attributes:
        enough: asked after every slice: whether the simulation may end before its time.
    """

    enough = False

    def begin(self, simulation: Simulation) -> None:
        """`simulation` runs as soon as all observers have returned from this."""

    def ready(self, tick: int) -> None:
        """The slice from `tick` on is next: what is now written into a component's memory acts from that tick on."""

    def take(self, first: int, rows: np.ndarray, events: list[TickEvent]) -> None:
        """A slice is over.

        Args:
            first: tick of the first row.
            rows: (n, width of the system's outputs), overwritten by the next slice; fewer than in other slices at the
                end, none if a component failed in its first tick.
            events: what happened in it as far as the observers before this one found out, by ascending ticks; one that
                finds more puts it in.
        """


Show = Callable[[int, int], None]
"""Told (ticks done, ticks in all) after every slice."""


class Progress(Observer):
    """Tells how far a run of `ticks` has come."""

    def __init__(self, show: Show, ticks: int):
        self._show, self._ticks = show, ticks

    def take(self, first: int, rows: np.ndarray, events: list[TickEvent]) -> None:
        self._show(first + len(rows), self._ticks)


UNDER_FORCE = (PhaseKind.HOLD, PhaseKind.CIRCLE, PhaseKind.PUSH)
SIGNALS = ("plant.F_ee_B", "controller.task", "controller.phase")


@dataclass(frozen=True)
class Held:
    """The true pressing force of one task.

    Attributes:
        task: its number, counted from 1.
        kind: press, tap, roll or push.
        force: asked for (N).
        taps: how many there were; 0 of other tasks.
        least, largest: of the force while it is to be held, of taps of their peaks (N); None: it never came to that.
        begin, end: first and last time of that (s).
    """

    task: int
    kind: str
    force: float
    taps: int = 0
    least: float | None = None
    largest: float | None = None
    begin: float | None = None
    end: float | None = None


class HeldForce(Observer):
    """Finds the force of each task. How rows are sliced makes no difference.

    Args:
        system: with plant and controller.
        tasks: of the experiment.
    """

    def __init__(self, system: System, tasks: Sequence[Task]):
        self._tick, self._tasks = system.tick, tasks
        # a controller of another make need not tell
        known = bool(tasks) and all(system.has(name) for name in SIGNALS)
        F, task, phase = (system.columns(name).start if known else 0 for name in SIGNALS)
        self._columns = [F + 2, task, phase] if known else []
        self._spans = [(-1, -1)] * len(tasks)
        self._extremes = [(np.inf, -np.inf)] * len(tasks)
        self._peaks: list[list[float]] = [[] for _ in tasks]
        self._tapping = False

    def take(self, first: int, rows: NDArray[np.float64], events: list[TickEvent]) -> None:
        if not len(rows) or not self._columns:
            return
        F_ee_z, number, phase = rows[:, self._columns].T
        for task in np.unique(number).astype(int):
            index = task - 1
            if not 0 <= index < len(self._tasks):
                continue
            its = number == task
            if isinstance(self._tasks[index], Tap):
                self._tap(index, first, -F_ee_z[its], phase[its], np.flatnonzero(its))
            elif np.any(on := its & np.isin(phase, UNDER_FORCE)):
                F_z, (least, largest) = -F_ee_z[on], self._extremes[index]
                self._extremes[index] = min(least, float(F_z.min())), max(largest, float(F_z.max()))
                self._seen(index, first + np.flatnonzero(on))

    def _tap(
        self, index: int, first: int, F_z: NDArray[np.float64], phase: NDArray[np.float64], at: NDArray[np.intp]
    ) -> None:
        """Each tap lasts from its start to the start of the next."""
        tapping = phase == PhaseKind.TAP
        starts = np.flatnonzero(tapping & ~np.append(self._tapping, tapping[:-1]))
        self._tapping = bool(tapping[-1])
        peaks = self._peaks[index]
        edges = [0, *starts, len(F_z)]
        for number, (begin, end) in enumerate(pairwise(edges)):
            largest = float(F_z[begin:end].max(initial=0.0))
            if number:
                peaks.append(largest)
            elif peaks:
                peaks[-1] = max(peaks[-1], largest)
        if np.any(tapping):
            self._seen(index, first + at[tapping])

    def _seen(self, index: int, ticks: NDArray[np.intp]) -> None:
        begin = self._spans[index][0]
        self._spans[index] = (int(ticks[0]) if begin < 0 else begin, int(ticks[-1]))

    @property
    def held(self) -> tuple[Held, ...]:
        """Of each task in its order; nothing if the controller does not say which task is on."""
        return tuple(self._held(index) for index in range(len(self._tasks) if self._columns else 0))

    def _held(self, index: int) -> Held:
        task, (begin, end), peaks = self._tasks[index], self._spans[index], self._peaks[index]
        if begin < 0:
            return Held(index + 1, task.kind, task.force)
        least, largest = (min(peaks), max(peaks)) if peaks else self._extremes[index]
        return Held(
            index + 1, task.kind, task.force, len(peaks), least, largest, begin * self._tick, end * self._tick
        )  # fmt: skip


LONG_SLICE = 1000
"""Ticks. Where nobody waits for a slice it may be long; but its rows are to stay in the processor's cache."""


def other_trip(monitor: Component) -> str:
    """What is to be said of a trip of a monitor of another make."""
    return f"safety monitor: {monitor.label or monitor.name} has tripped; why, its output 'reason' may say"


class Assembled(Protocol):
    """What has a system."""

    @property
    def system(self) -> System:
        """To be stepped."""


@dataclass(frozen=True)
class Simulated:
    """A simulation that is over.

    Attributes:
        simulation: how far it came, and what ended it too early, if anything did.
        stepping: wall time in the master (s).
        monitor: twin's own; None if nobody watches, or one of another make.
    """

    simulation: Simulation
    stepping: float
    monitor: SafetyMonitor | None

    @property
    def failure(self) -> ComponentFailed | None:
        return self.simulation.failure

    def completed(self) -> Self:
        """The same, of a simulation in which no component failed.

        Raises:
            ComponentFailed: one did.
        """
        if self.failure:
            raise self.failure
        return self

    @property
    def trip(self) -> str:
        """Why the safety monitor tripped; "" if it did not."""
        if self.monitor:
            return trip_sentence(self.monitor.trip) if self.monitor.trip else ""
        if not self.simulation.system.has("monitor.tripped"):
            return ""
        other = self.simulation.system.component("monitor")
        tripped = by_port(other.outputs, self.simulation.outputs(other))["tripped"][0] != 0.0
        return other_trip(other) if tripped else ""

    @property
    def costs(self) -> dict[str, float]:
        """Wall time per tick of each component (s), by its name; {} if they were not timed."""
        cycles, ticks = self.simulation.cycles, max(1, self.simulation.next_tick)
        share = self.stepping / max(1, cycles.sum()) / ticks
        return {c.name: float(n * share) for c, n in zip(self.simulation.system.components, cycles, strict=False)}


def simulate(
    assembly: Assembled,
    last_tick: int,
    observers: Sequence[Observer] = (),
    slice_ticks: int = LONG_SLICE,
    timed: bool = False,
) -> Simulated:
    """Step the robot from tick 0 until `last_tick`, a component fails, or one of the `observers` has seen enough.

    Args:
        assembly: freshly made; of other systems than the robot only that.
        last_tick: the tick that gets the last row and no step.
        observers: called in this order.
        slice_ticks: most ticks of a slice.
        timed: measure each component.
    """
    simulation = Simulation(assembly.system, last_tick, slice_ticks, timed)
    for observer in observers:
        observer.begin(simulation)
    stepping = 0.0
    while not simulation.finished and not any(observer.enough for observer in observers):
        first = simulation.next_tick
        for observer in observers:
            observer.ready(first)
        began = time.perf_counter()
        rows = simulation.advance()
        stepping += time.perf_counter() - began
        events: list[TickEvent] = []
        for observer in observers:
            observer.take(first, rows, events)
    monitor = next((c for c in assembly.system.components if isinstance(c, SafetyMonitor)), None)
    return Simulated(simulation, stepping, monitor)
