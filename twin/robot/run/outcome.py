"""What a run came to in a few numbers of what is true, summed up as it goes: nothing is read again."""

import math
from copy import copy
from dataclasses import dataclass

import numpy as np

from twin.kernel.cosim.observers import Observer, TickEvent
from twin.kernel.cosim.system import System
from twin.robot.plant.deviation import Deviation

END = 1.0
"""The end of a run is its last second (s)."""
BLOCK = 1000
"""Rows that are summed up at once."""
LOOKED_AT = slice(2, None)
"""Of the columns, where x and y of the force are for the end of the run only."""


@dataclass(frozen=True)
class RunOutcome:
    """Numbers of the plant, not of what the controller believes.

    Attributes:
        peak, peak_time: largest pressing force (N) and when (s).
        end: mean pressing force of the last second (N).
        end_x, end_y: mean force along x and y, by the robot on what it touches, of the last second (N).
        force_error: rms of the pressing force off its reference while the force loop is on, from the first touch on
            (N): a robot that moves through air is held to no force. None: the loop never was on, or nothing touched.
        lateral_error, z_error: rms of the position off the pre-defined reference, in x and y together, and in z (m);
            None: the controller, one of another make, tells of no reference.
        early_trigger: how long the force loop was on before the first touch (s), until the end if there was none; 0: it
            came on in contact; None: never.
    """

    peak: float
    peak_time: float
    end: float
    end_x: float
    end_y: float
    force_error: float | None
    lateral_error: float | None
    z_error: float | None
    early_trigger: float | None


class Tally(Observer):
    """Sums up the rows of a run. How they are sliced makes no difference, not even to the last bit.

    Args:
        system: with the components plant and controller of `twin.robot.assembly`.
    """

    def __init__(self, system: System):
        self._tick = system.tick
        told = "controller.p_ref_B" if system.has("controller.p_ref_B") else "reference.p_ref_B"
        signals = {"plant.F_ee_B": 3, "plant.p_B": 3, told: 3, "controller.triggered": 1, "controller.F_z_ref": 1}
        # below 0 where a system has no such signal
        found = [
            system.columns(name).start + np.arange(size) if system.has(name) else np.full(size, -1)
            for name, size in signals.items()
        ]
        self._columns = np.concatenate(found)
        # of rows that wait for the others of their block
        self._waiting_columns = np.where(self._columns < 0, -1, np.arange(len(self._columns)))
        self._waiting, self._filled = np.empty((BLOCK, len(self._columns))), 0
        self._deviation = Deviation(BLOCK)
        self._count = self._controlled = 0
        self._squares = np.zeros(3)
        self._force_squares = 0.0
        self._peak, self._peak_tick = -math.inf, 0
        self._touch_tick = self._trigger_tick = -1
        self._last = np.empty((0, 3))

    def take(self, first: int, rows: np.ndarray, events: list[TickEvent]) -> None:
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
    def outcome(self) -> RunOutcome:
        """Of at least one row."""
        total = copy(self)
        if self._filled:
            total._add(self._waiting[: self._filled], self._waiting_columns)
        x, y, z = total._squares / total._count
        controlled = total._controlled
        return RunOutcome(
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

    def _early_trigger(self) -> float | None:
        if self._trigger_tick < 0:
            return None
        touch = self._touch_tick if self._touch_tick >= 0 else self._count
        return max(0, touch - self._trigger_tick) * self._tick
