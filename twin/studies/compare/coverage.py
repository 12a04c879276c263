"""How much of a reference another log has values for."""

import numpy as np

from twin.recording.logs.log import Series

LOST_SAMPLE = 2.0
"""Periods. Two samples so far apart are as dense as a log of half the rate, which covers all that it spans; one that is
lost now and then is no hole."""


def coverage(ours: Series, theirs: Series) -> float:
    """Share of the time of `ours` that `theirs` covers, 0 .. 1; exactly 1 if it covers all of it.

    A sampled signal begins up to a period after its source and ends up to a period before it, so a period of the
    coarser of the two is no lack at either end. Gaps are holes from more than one lost sample on, except where `ours`
    has a gap, too.
    """
    period = max(ours.sampling.period, theirs.sampling.period)
    # stamps of nanoseconds as doubles
    slack = period * (1.0 + 1e-6)
    start, end = float(ours.t[0]), float(ours.t[-1])
    early, late = float(theirs.t[0]) - start, end - float(theirs.t[-1])
    holes = theirs.sampling.gaps
    holes = holes[np.diff(holes, axis=1)[:, 0] > LOST_SAMPLE * slack]
    ends = [(start, start + early)] * (early > slack) + [(end - late, end)] * (late > slack)
    lost = np.clip(np.array([*ends, *holes]).reshape(-1, 2), start, end)
    # how much of the time before is in gaps of its own: constant outside of them
    own = ours.sampling.gaps
    gone = np.repeat(np.cumsum([0.0, *np.diff(own, axis=1)[:, 0]]), 2)
    breaks = np.array([start, *own.ravel(), end])
    in_own = np.diff(np.interp(lost, breaks, gone), axis=1)
    missing = float(np.sum(np.diff(lost, axis=1) - in_own))
    return 1.0 if missing <= 0.0 else max(0.0, 1.0 - missing / (end - start - float(gone[-1])))
