"""How much a signal swings, and how fast: the strongest sine in it."""

import numpy as np

from twin.studies.metrics.response import Curve

PERIODS = 4
"""The least that a window holds of the slowest swing: half the width of a Hann window's main lobe is 2 / window, so
what is left of a drift has died away by then."""
PADDED = 8
"""Times the window's length: a sine between two frequencies of the transform loses less than 0.3 % of its amplitude."""


def strongest_swing(t: Curve, y: Curve, lowest: float) -> tuple[float, float]:
    """(amplitude, frequency) of the strongest sine in y, in the unit of y and Hz; its straight line is taken off first.

    The largest value of the amplitude spectrum with a Hann window (Harris, On the use of windows for harmonic analysis
    with the discrete Fourier transform, Proc. IEEE 66, 1978). A swing that dies away counts with its mean over the
    window, weighted by that.

    Args:
        t, y: evenly spaced samples (n,) over at least `PERIODS` periods of `lowest`.
        lowest: frequencies below it (Hz) are no swing.
    """
    from scipy.signal import periodogram

    f, power = periodogram(
        y, 1.0 / (t[1] - t[0]), window="hann", nfft=PADDED * len(y), detrend="linear", scaling="spectrum"
    )
    slow = f < lowest
    power[slow] = 0.0
    best = int(np.argmax(power))
    # of a sine of amplitude a the spectrum holds a^2 / 2
    return float(np.sqrt(2.0 * power[best])), float(f[best])
