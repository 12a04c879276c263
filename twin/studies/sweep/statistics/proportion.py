"""How likely something is that was seen in so many of so many runs."""

import math

_NORMAL_95 = 1.959963984540054
"""Quantile of the standard normal distribution at 0.975."""


def wilson_interval(successes: int, runs: int) -> tuple[float, float]:
    """95 % interval of a probability, inside 0 .. 1 also where all runs or none succeed; (0, 1) of no runs.

    Source: Wilson (1927); recommended for small numbers by Brown, Cai and DasGupta (2001).
    """
    if runs == 0:
        return 0.0, 1.0
    share, z2 = successes / runs, _NORMAL_95**2
    middle = (share + z2 / (2 * runs)) / (1.0 + z2 / runs)
    half = _NORMAL_95 * math.sqrt(share * (1.0 - share) / runs + z2 / (4 * runs * runs)) / (1.0 + z2 / runs)
    return max(0.0, middle - half), min(1.0, middle + half)
