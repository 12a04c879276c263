"""The outcome of a run: a few numbers of the true state, accumulated while it runs."""

import math
from collections.abc import Sequence
from copy import copy
from dataclasses import dataclass, replace
from itertools import pairwise

import numpy as np
from numpy.typing import NDArray

from twin.kernel.cosim.observers import Observer, TickEvent
from twin.kernel.cosim.simulation import Simulation
from twin.kernel.cosim.system import System
from twin.kernel.errors import InputRefused
from twin.robot.controller.program import PhaseKind, Tap, Task
from twin.robot.plant.deviation import DeviationSums
from twin.robot.run.hold import UNDER_FORCE, HoldRequest, HoldSums, Layout, TaskHold, signal_columns
from twin.robot.run.measures import RunOutcome, measured

SIGNALS = ("plant.F_ee_B", "controller.task", "controller.phase")


@dataclass(frozen=True)
class HeldForces:
    """The true pressing force of one task.

    Attributes:
        task: its number, counted from 1.
        kind: press, tap, roll or push.
        force: asked for (N).
        taps: how many there were; 0 of other tasks.
        least, largest: of the force while it is to be held, of taps of their peaks (N); None: it never came to that.
        begin, end: first and last time of that (s).
        error, mean_error: rms and mean of the force minus its reference while it is held (N); None of taps.
        overshoot: largest force beyond the task's, as a share of it, until 1 s after it begins to be held.
    """

    task: int
    kind: str
    force: float
    taps: int = 0
    least: float | None = None
    largest: float | None = None
    begin: float | None = None
    end: float | None = None
    error: float | None = None
    mean_error: float | None = None
    overshoot: float | None = None


class HeldForce(Observer):
    """Finds the force of each task. How rows are sliced makes no difference.

    Args:
        system: with plant and controller.
        tasks: of the experiment.
    """

    lasting = ("_spans", "_extremes", "_peaks", "_tapping")

    def __init__(self, system: System, tasks: Sequence[Task]):
        self._tick, self._tasks = system.tick, tasks
        # a third-party controller need not tell
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
    def held(self) -> tuple[HeldForces, ...]:
        """Of each task in its order; nothing if the controller does not say which task is on."""
        return tuple(self._held(index) for index in range(len(self._tasks) if self._columns else 0))

    def _held(self, index: int) -> HeldForces:
        task, (begin, end), peaks = self._tasks[index], self._spans[index], self._peaks[index]
        if begin < 0:
            return HeldForces(index + 1, task.kind, task.force)
        least, largest = (min(peaks), max(peaks)) if peaks else self._extremes[index]
        return HeldForces(
            index + 1, task.kind, task.force, len(peaks), least, largest, begin * self._tick, end * self._tick
        )  # fmt: skip


END = 1.0
"""The end of a run is its last second (s)."""
BLOCK = 1000
"""Rows that are summed up at once."""
LOOKED_AT = slice(2, None)
"""Of the columns, where x and y of the force are for the end of the run only."""
DEVIATION_SIGNALS = {
    "plant.F_ee_B": 3, "plant.p_B": 3, "controller.p_ref_B": 3, "controller.triggered": 1, "controller.F_z_ref": 1,
}  # fmt: skip
"""Signals that the errors since the first touch are made of, and their sizes."""


class Tally(Observer):
    """Sums up the rows of a run. How they are sliced makes no difference, not even to the last bit.

    Args:
        system: with the components plant and controller of `twin.robot.assembly`.
        request: of the experiment.
    """

    lasting = (
        "_rows_waiting", "_rows_at_end", "_count", "_controlled", "_squares", "_force_squares", "_peak", "_peak_tick",
        "_touch_tick", "_trigger_tick", "_sums",
    )  # fmt: skip

    def __init__(self, system: Layout, request: HoldRequest):
        self._tick = system.tick
        self._hold = HoldSums(system, request)
        self._columns = np.concatenate([signal_columns(system, *signal) for signal in DEVIATION_SIGNALS.items()])
        # of rows that wait for the others of their block
        self._waiting_columns = np.where(self._columns < 0, -1, np.arange(len(self._columns)))
        self._waiting, self._filled = np.empty((BLOCK, len(self._columns))), 0
        self._deviation = DeviationSums(BLOCK)
        self._count = self._controlled = 0
        self._squares = np.zeros(3)
        self._force_squares = 0.0
        self._peak, self._peak_tick = -math.inf, 0
        self._touch_tick = self._trigger_tick = -1
        self._last = np.empty((0, 3))

    def begin(self, simulation: Simulation) -> None:
        self._simulation = simulation

    @property
    def _sums(self) -> NDArray[np.float64]:
        return self._hold.state

    @_sums.setter
    def _sums(self, values: NDArray[np.float64]) -> None:
        self._hold.state = values

    @property
    def _rows_waiting(self) -> NDArray[np.float64]:
        return self._waiting[: self._filled]

    @_rows_waiting.setter
    def _rows_waiting(self, rows: NDArray[np.float64]) -> None:
        if len(rows) >= BLOCK or rows.shape[1:] != self._waiting.shape[1:]:
            raise InputRefused("the state has other rows than the outcome of a run is made of")
        self._waiting[: len(rows)], self._filled = rows, len(rows)

    @property
    def _rows_at_end(self) -> NDArray[np.float64]:
        """Of the last second those that its end may still need."""
        ahead = self._simulation.last_tick - self._simulation.next_tick + 1
        needed = max(0, round(END / self._tick) - ahead)
        return self._last[max(0, len(self._last) - needed) :]

    @_rows_at_end.setter
    def _rows_at_end(self, rows: NDArray[np.float64]) -> None:
        if rows.shape[1:] != (3,):
            raise InputRefused("the state has other rows than the outcome of a run is made of")
        self._last = rows

    def take(self, first: int, rows: np.ndarray, events: list[TickEvent]) -> None:
        self._hold.take(first, rows)
        # sums of floating-point numbers depend on their order: these are always of the same rows
        while len(rows):
            if not self._filled and len(rows) >= BLOCK:
                self._add(rows[:BLOCK], self._columns)
                rows = rows[BLOCK:]
                continue
            some = rows[: BLOCK - self._filled]
            self._waiting[self._filled : self._filled + len(some)] = some[:, self._columns]
            self._filled, rows = self._filled + len(some), rows[len(some) :]
            if self._filled == BLOCK:
                self._add(self._waiting, self._waiting_columns)
                self._filled = 0

    def _add(self, rows: np.ndarray, columns: np.ndarray) -> None:
        block = self._deviation
        block.look(rows, columns[LOOKED_AT], self._touch_tick >= 0)
        if self._touch_tick < 0 <= block.touch:
            self._touch_tick = self._count + block.touch
        if self._trigger_tick < 0 <= block.trigger:
            self._trigger_tick = self._count + block.trigger
        if block.peak > self._peak:
            self._peak, self._peak_tick = block.peak, self._count + block.place
        self._controlled += len(block.off)
        self._force_squares += float(np.sum(block.off))
        self._squares = self._squares + block.squares
        self._count += len(rows)
        wanted = round(END / self._tick)
        recent = rows[-wanted:, columns[:3]]
        self._last = recent if len(recent) == wanted else np.concatenate([self._last, recent])[-wanted:]

    @property
    def tasks(self) -> tuple[TaskHold, ...]:
        """How each task holds its force, in their order."""
        return self._hold.tasks

    @property
    def outcome(self) -> RunOutcome:
        """The numbers of at least one row."""
        total = copy(self)
        if self._filled:
            total._add(self._waiting[: self._filled], self._waiting_columns)
        x, y, z = total._squares / total._count
        controlled = total._controlled
        found = RunOutcome(
            peak=total._peak,
            peak_time=total._peak_tick * total._tick,
            end=float(np.mean(-total._last[:, 2])),
            end_x=float(np.mean(total._last[:, 0])),
            end_y=float(np.mean(total._last[:, 1])),
            force_error=math.sqrt(total._force_squares / controlled) if controlled else None,
            lateral_error=None if math.isnan(x + y) else math.sqrt(x + y),
            z_error=None if math.isnan(z) else math.sqrt(z),
            early_trigger=total._early_trigger(),
        )
        return replace(found, measures=measured(self._hold, found))

    def _early_trigger(self) -> float | None:
        if self._trigger_tick < 0:
            return None
        touch = self._touch_tick if self._touch_tick >= 0 else self._count
        return max(0, touch - self._trigger_tick) * self._tick
