"""What a run came to in a few numbers of what is true, summed up as it goes: nothing is read again."""

import math
from copy import copy
from dataclasses import dataclass

import numpy as np

from twin.cosim.system import System
from twin.runs.observer import Observer, TickEvent

END = 1.0
"""The end of a run is its last second (s)."""
BLOCK = 1000
"""Rows that are summed up at once."""


@dataclass(frozen=True)
class RunOutcome:
    """Numbers of the plant, not of what the controller believes.

    Attributes:
        peak, peak_time: largest pressing force (N) and when (s).
        end: mean pressing force of the last second (N).
        end_x, end_y: mean force along x and y, by the robot on what it touches, of the last second (N).
        force_error: rms of the pressing force off its reference while the force loop is on (N); None: it never was.
        lateral_error, z_error: rms of the position off the pre-defined reference, in x and y together, and in z (m);
            None: the controller, one of another make, tells of no reference.
    """

    peak: float
    peak_time: float
    end: float
    end_x: float
    end_y: float
    force_error: float | None
    lateral_error: float | None
    z_error: float | None


class Tally(Observer):
    """Sums up the rows of a run. How they are sliced makes no difference, not even to the last bit.

    Args:
        system: with the components plant and controller of `twin.runs.assembly`.
    """

    def __init__(self, system: System):
        self._tick = system.tick
        told = "controller.p_ref_B" if system.has("controller.p_ref_B") else "reference.p_ref_B"
        signals = {"plant.F_ee_B": 3, "plant.p_B": 3, told: 3, "controller.triggered": 1, "controller.F_z_ref": 1}
        found = [(system.columns(name).start if system.has(name) else -size, size) for name, size in signals.items()]
        self._columns = np.concatenate([np.arange(first, first + size) for first, size in found])
        self._waiting = np.empty((0, 11))
        self._count = self._controlled = 0
        self._squares = np.zeros(3)
        self._force_squares = 0.0
        self._peak, self._peak_tick = -math.inf, 0
        self._last = np.empty((0, 3))

    def take(self, first: int, rows: np.ndarray, events: list[TickEvent]) -> None:
        waiting = rows.take(self._columns, axis=1)
        waiting[:, self._columns < 0] = math.nan
        if len(self._waiting):
            waiting = np.vstack([self._waiting, waiting])
        # sums of floating-point numbers depend on their order: these are always of the same rows
        whole = len(waiting) // BLOCK * BLOCK
        for first in range(0, whole, BLOCK):
            self._add(waiting[first : first + BLOCK])
        self._waiting = waiting[whole:]

    def _add(self, rows: np.ndarray) -> None:
        F_z, p_B, p_ref_B, on, F_z_ref = -rows[:, 2], rows[:, 3:6], rows[:, 6:9], rows[:, 9] > 0.0, rows[:, 10]
        highest = int(np.argmax(F_z))
        if F_z[highest] > self._peak:
            self._peak, self._peak_tick = float(F_z[highest]), self._count + highest
        self._controlled += int(np.count_nonzero(on))
        self._force_squares += float(np.sum(np.square(F_z_ref[on] - F_z[on])))
        self._squares = self._squares + np.sum(np.square(p_B - p_ref_B), axis=0)
        self._count += len(rows)
        self._last = np.concatenate([self._last, rows[:, :3]])[-round(END / self._tick) :]

    @property
    def outcome(self) -> RunOutcome:
        """Of at least one row."""
        total = copy(self)
        if len(self._waiting):
            total._add(self._waiting)
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
        )
