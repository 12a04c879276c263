"""What a run came to in a few numbers of what is true, summed up as it goes: nothing is read again."""

import math
from dataclasses import dataclass

import numpy as np

from twin.cosim.system import System

END = 1.0
"""The end of a run is its last second (s)."""


@dataclass(frozen=True)
class Outcome:
    """Numbers of the plant, not of what the controller believes.

    Attributes:
        peak, peak_time: largest pressing force (N) and when (s).
        end: mean pressing force of the last second (N).
        force_error: rms of the pressing force off its reference while the force loop is on (N); None: it never was.
        lateral_error, z_error: rms of the position off the pre-defined reference, in x and y together, and in z (m).
    """

    peak: float
    peak_time: float
    end: float
    force_error: float | None
    lateral_error: float
    z_error: float


class Tally:
    """Sums up the rows of a run.

    Args:
        system: with the components plant and controller of `twin.assembly`.
    """

    def __init__(self, system: System):
        self._tick = system.tick
        signals = ("plant.F_ee_B", "plant.p_B", "controller.p_ref_B", "controller.triggered", "controller.F_z_ref")
        self._columns = [system.columns(name) for name in signals]
        self._count = self._controlled = 0
        self._squares = np.zeros(3)
        self._force_squares = 0.0
        self._peak, self._peak_tick = -math.inf, 0
        self._last = np.empty(0)

    def take(self, rows: np.ndarray) -> None:
        """Go on with `rows` (n, width), one per tick."""
        if len(rows) == 0:
            return
        F_ee_B, p_B, p_ref_B, triggered, F_z_ref = (rows[:, columns] for columns in self._columns)
        F_z = -F_ee_B[:, 2]
        highest = int(np.argmax(F_z))
        if F_z[highest] > self._peak:
            self._peak, self._peak_tick = float(F_z[highest]), self._count + highest
        on = triggered[:, 0] > 0.0
        self._controlled += int(np.count_nonzero(on))
        self._force_squares += float(np.sum(np.square(F_z_ref[on, 0] - F_z[on])))
        self._squares += np.sum(np.square(p_B - p_ref_B), axis=0)
        self._count += len(rows)
        self._last = np.concatenate([self._last, F_z])[-round(END / self._tick) :]

    @property
    def outcome(self) -> Outcome:
        """Of at least one row."""
        x, y, z = self._squares / self._count
        controlled = self._controlled
        return Outcome(
            peak=self._peak,
            peak_time=self._peak_tick * self._tick,
            end=float(np.mean(self._last)),
            force_error=math.sqrt(self._force_squares / controlled) if controlled else None,
            lateral_error=math.sqrt(x + y),
            z_error=math.sqrt(z),
        )
