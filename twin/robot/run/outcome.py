"""Outcome of a run: summary numbers of the true state, accumulated while it runs."""

import math
from copy import copy
from dataclasses import replace

import numpy as np
from numpy.typing import NDArray

from twin.kernel.cosim.observers import Observer, TickEvent
from twin.kernel.cosim.simulation import Simulation
from twin.kernel.errors import InputRefused
from twin.robot.plant.deviation import DeviationSums
from twin.robot.run.hold import HeldForces, HoldRequest, HoldSums, RowLayout, signal_columns
from twin.robot.run.measures import RunOutcome, compute_measures

END_TIME = 1.0
"""Duration (s) of the end of a run, over which its final force is averaged."""
BLOCK_ROWS = 1000
"""Rows summed at once."""
DEVIATION_COLUMNS = slice(2, None)
"""Columns of the deviation sums; x and y of the force are used for the end of the run only."""
DEVIATION_SIGNALS = {
    "plant.F_ee_B": 3, "plant.p_B": 3, "controller.p_ref_B": 3, "controller.triggered": 1, "controller.F_z_ref": 1,
}  # fmt: skip
"""Signals of the errors since the first touch, and their sizes."""


class Tally(Observer):
    """Observer that accumulates the summary numbers of a run, bit-identical however its rows are sliced.

    `system` is the layout of the rows, with the plant and controller of `twin.robot.assembly`.
    """

    lasting = (
        "_rows_waiting", "_rows_at_end", "_count", "_controlled", "_squares", "_force_squares", "_peak", "_peak_tick",
        "_touch_tick", "_trigger_tick", "_sums",
    )  # fmt: skip

    def __init__(self, system: RowLayout, request: HoldRequest):
        self._tick = system.tick
        self._hold = HoldSums(system, request)
        self._columns = np.concatenate([signal_columns(system, *signal) for signal in DEVIATION_SIGNALS.items()])
        # columns within the buffer of rows that wait for a full block
        self._waiting_columns = np.where(self._columns < 0, -1, np.arange(len(self._columns)))
        self._waiting, self._filled = np.empty((BLOCK_ROWS, len(self._columns))), 0
        self._deviation = DeviationSums(BLOCK_ROWS)
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
        if len(rows) >= BLOCK_ROWS or rows.shape[1:] != self._waiting.shape[1:]:
            raise InputRefused("the state has other rows than the outcome of a run is made of")
        self._waiting[: len(rows)], self._filled = rows, len(rows)

    @property
    def _rows_at_end(self) -> NDArray[np.float64]:
        """Force vectors (n, 3) of the last second that the mean force at the end may still need."""
        ahead = self._simulation.last_tick - self._simulation.next_tick + 1
        needed = max(0, round(END_TIME / self._tick) - ahead)
        return self._last[max(0, len(self._last) - needed) :]

    @_rows_at_end.setter
    def _rows_at_end(self, rows: NDArray[np.float64]) -> None:
        if rows.shape[1:] != (3,):
            raise InputRefused("the state has other rows than the outcome of a run is made of")
        self._last = rows

    def on_rows(self, first: int, rows: np.ndarray, events: list[TickEvent]) -> None:
        self._hold.add_rows(first, rows)
        # floating-point sums depend on their order, so blocks always consist of the same rows
        while len(rows):
            if not self._filled and len(rows) >= BLOCK_ROWS:
                self._add(rows[:BLOCK_ROWS], self._columns)
                rows = rows[BLOCK_ROWS:]
                continue
            some = rows[: BLOCK_ROWS - self._filled]
            self._waiting[self._filled : self._filled + len(some)] = some[:, self._columns]
            self._filled, rows = self._filled + len(some), rows[len(some) :]
            if self._filled == BLOCK_ROWS:
                self._add(self._waiting, self._waiting_columns)
                self._filled = 0

    def _add(self, rows: np.ndarray, columns: np.ndarray) -> None:
        block = self._deviation
        block.add_block(rows, columns[DEVIATION_COLUMNS], self._touch_tick >= 0)
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
        wanted = round(END_TIME / self._tick)
        recent = rows[-wanted:, columns[:3]]
        self._last = recent if len(recent) == wanted else np.concatenate([self._last, recent])[-wanted:]

    @property
    def held_forces(self) -> tuple[HeldForces, ...]:
        """Held force of each massage task, in order; empty if the controller does not report the current task."""
        return self._hold.tasks

    @property
    def outcome(self) -> RunOutcome:
        """Summary numbers of the run so far; at least one row is needed."""
        total = copy(self)
        if self._filled:
            total._add(self._waiting[: self._filled], self._waiting_columns)
        x, y, z = total._squares / total._count
        # NaN without a reference of the force
        known = total._controlled and not math.isnan(total._force_squares)
        found = RunOutcome(
            peak=total._peak,
            peak_time=total._peak_tick * total._tick,
            end=float(np.mean(-total._last[:, 2])),
            end_x=float(np.mean(total._last[:, 0])),
            end_y=float(np.mean(total._last[:, 1])),
            force_error=math.sqrt(total._force_squares / total._controlled) if known else None,
            lateral_error=None if math.isnan(x + y) else math.sqrt(x + y),
            z_error=None if math.isnan(z) else math.sqrt(z),
            early_trigger=total._early_trigger(),
        )
        return replace(found, measures=compute_measures(self._hold, found))

    def _early_trigger(self) -> float | None:
        if self._trigger_tick < 0:
            return None
        touch = self._touch_tick if self._touch_tick >= 0 else self._count
        return max(0, touch - self._trigger_tick) * self._tick
