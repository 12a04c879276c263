"""The pressing force while a task holds it: of each task, from the rows of a run as it goes."""

from collections.abc import Sequence
from dataclasses import dataclass
from itertools import pairwise

import numpy as np
from numpy.typing import NDArray

from twin.kernel.cosim.observers import Observer, TickEvent
from twin.kernel.cosim.system import System
from twin.robot.controller.program import PhaseKind, Tap, Task

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
