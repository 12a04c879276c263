"""Disk margins: how far gain and phase of several loops may be off, all at once and each as it likes.

Each loop is multiplied by a complex number f of its own, from a disk (Seiler, Packard and Gahinet 2020, An Introduction
to Disk Margins, IEEE Control Systems 40(5):78):

    f = (1 + (1 - sigma)/2 delta) / (1 - (1 + sigma)/2 delta),  |delta| < alpha.

The loops stay stable for all of them up to alpha = 1 / max mu(S + (sigma - 1)/2 1), the largest over all frequencies, S
being their sensitivity. Balanced, sigma = 0, the disk reaches from (1 - alpha/2)/(1 + alpha/2) to its inverse on the
real axis, and holds all turns of up to 2 arctan(alpha/2).

All of it is of the linear model, at the frequencies that are looked at: what is narrower than their grid is not seen.
"""

from collections.abc import Sequence
from typing import NamedTuple

import numpy as np

from twin.studies.analyse.linear.drive_model import Matrix
from twin.studies.analyse.linear.loops import Loops
from twin.studies.analyse.linear.margins import Complex, frequencies, sensitivity
from twin.studies.analyse.linear.structured import largest

BETWEEN = 25
"""Frequencies looked at between that of the smallest margin and the next ones, twice."""


class DiskMargin(NamedTuple):
    """How far all loops of the linear model may be off at once, at the frequencies that were looked at.

    Attributes:
        alpha: size of the disk; at least that for more than three loops.
        frequency: of the swing that they then have (rad/s).
    """

    alpha: float
    frequency: float

    @property
    def gain(self) -> float | None:
        """Factor by which each gain may grow or shrink; None: by any."""
        return (2.0 + self.alpha) / (2.0 - self.alpha) if self.alpha < 2.0 else None

    @property
    def phase(self) -> float:
        """By which each phase may be off (rad)."""
        return float(2.0 * np.arctan(0.5 * self.alpha))

    def facts(self) -> dict[str, float | None]:
        """For JSON, SI."""
        return {"alpha": self.alpha, "frequency": self.frequency, "gain": self.gain, "phase": self.phase}


def smallest_disk(S: Complex, skew: float = 0.0) -> tuple[int, float]:
    """(which, alpha) of the sensitivity (n, k, k) that leaves the smallest disk, with sigma = `skew`."""
    which, mu = largest(S + 0.5 * (skew - 1.0) * np.eye(S.shape[-1]))
    return which, 1.0 / mu


def disk_margin(loops: Loops, gains: dict[str, float], breaks: Sequence[str]) -> DiskMargin:
    """Of the loops opened at all `breaks` at once, see `sensitivity`, of a system that is stable."""
    omega = frequencies(loops.dt)
    for _ in range(3):
        which, alpha = smallest_disk(sensitivity(loops, gains, breaks, omega))
        found = DiskMargin(alpha, float(omega[which]))
        omega = _around(omega, which)
    return found


def _around(omega: Matrix, which: int) -> Matrix:
    """Frequencies from the one before `which` to the one after it."""
    low, high = omega[max(which - 1, 0)], omega[min(which + 1, len(omega) - 1)]
    return np.unique(np.concatenate([np.geomspace(low, high, 2 * BETWEEN + 1), [omega[which]]]))
