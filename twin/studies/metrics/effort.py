"""What a motion costs the drives."""

import numpy as np

from twin.studies.metrics.response import Curve


def travel(t: Curve, rate: Curve) -> float:
    """Control effort: the integral of |rate|, summed over the columns of (n, k): how far the motors were sent."""
    return float(np.sum(np.trapezoid(np.abs(rate), t, axis=0)))


def work(t: Curve, torque: Curve, speed: Curve) -> tuple[float, float]:
    """(delivered, returned): work (J) of shafts on their loads, where power is positive and where it is negative.

    Args:
        t: s (n,).
        torque, speed: N m that opposes positive speed, rad/s, (n, k).
    """
    power = torque * speed
    delivered = np.sum(np.trapezoid(np.maximum(power, 0.0), t, axis=0))
    return float(delivered), float(-np.sum(np.trapezoid(np.minimum(power, 0.0), t, axis=0)))
