"""How far a quantity is from where it should be."""

import numpy as np

from twin.metrics.response import Curve


def rms(x: Curve) -> float:
    """Root of the mean square."""
    return float(np.sqrt(np.mean(np.square(x))))


def mean_error(y: Curve, reference: Curve | float) -> float:
    """Mean of |y - reference|."""
    return float(np.mean(np.abs(y - reference)))


def bump(t: Curve, y: Curve) -> tuple[float, float]:
    """(time, size) of the largest deviation of y from a cubic fitted to it: a fluctuation on a slow trend."""
    middle = 0.5 * (t[0] + t[-1])
    rest = y - np.polyval(np.polyfit(t - middle, y, 3), t - middle)
    worst = int(np.argmax(np.abs(rest)))
    return float(t[worst]), float(abs(rest[worst]))
