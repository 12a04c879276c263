"""What to add to the times of one log so that they mean those of another."""

from typing import Literal, NamedTuple, cast, get_args

import numpy as np

from twin.recording.logs.log import Log, LogSeries
from twin.studies.compare.tolerance import ComparisonRefused

Kind = Literal["none", "start", "event", "fit"]
LEAST_OVERLAP = 0.5
"""Share of the shorter series that a fitted shift must leave to compare; less would fit the ends to each other."""
STEPS = 500
"""Shifts tried on either side of none, at most, before the best is refined."""


class Alignment(NamedTuple):
    """How times are aligned.

    Attributes:
        kind: `none`: both count from the same instant. `start`: the first samples are the same instant. `event`:
            `signal` crosses the middle of the first log's range for the first time. `fit`: the rms difference of
            `signal` is least.
        signal: for event and fit.
        max_shift: for fit, s.
    """

    kind: Kind = "none"
    signal: str = ""
    max_shift: float = 1.0


class TimeShift(NamedTuple):
    """Seconds to add to the times of the second log, and a sentence where that is doubtful."""

    seconds: float = 0.0
    note: str = ""


def alignment(kind: str, signal: str = "", max_shift: float = 1.0) -> Alignment:
    """What `--align kind --by signal --max-shift` mean.

    Raises:
        ComparisonRefused: an unknown kind, no signal where one is needed, no positive shift.
    """
    if kind not in get_args(Kind):
        raise ComparisonRefused(f"--align {kind}: expected one of {', '.join(get_args(Kind))}")
    if kind in ("event", "fit") and not signal:
        raise ComparisonRefused(f"--align {kind}: by which signal? Add --by SIGNAL")
    if not 0.0 < max_shift < np.inf:
        raise ComparisonRefused(f"--max-shift {max_shift:g}: expected a time > 0 s")
    return Alignment(cast(Kind, kind), signal, max_shift)


def shift(a: Log, b: Log, how: Alignment) -> TimeShift:
    """What to add to the times of `b` to align it with `a`.

    Raises:
        ComparisonRefused: the signal shows nothing to align by.
        LogRefused: a log has no such signal.
    """
    if how.kind == "none":
        return TimeShift()
    if how.kind == "start":
        first = [min(series.t[0] for series in log.series.values()) for log in (a, b)]
        return TimeShift(float(first[0] - first[1]))
    ours, theirs = a[how.signal], b[how.signal]
    if np.ptp(ours.values) == 0.0 or np.ptp(theirs.values) == 0.0:
        raise ComparisonRefused(f"--by {how.signal}: is constant, so nothing in it can be aligned")
    if how.kind == "event":
        return _event(a, b, how.signal)
    return _fit(ours, theirs, how.max_shift)


def _event(a: Log, b: Log, signal: str) -> TimeShift:
    level = 0.5 * float(a[signal].values.min() + a[signal].values.max())
    times = []
    for log in (a, b):
        t, above = log[signal].t, log[signal].values - level
        crossings = np.flatnonzero((above[1:] >= 0.0) != (above[:-1] >= 0.0))
        if not len(crossings):
            raise ComparisonRefused(f"{log.path}: {signal} never crosses {level:.4g}, the middle of the first's range")
        k = crossings[0]
        times.append(float(t[k] + (t[k + 1] - t[k]) * above[k] / (above[k] - above[k + 1])))
    return TimeShift(times[0] - times[1])


def _fit(ours: LogSeries, theirs: LogSeries, limit: float) -> TimeShift:
    """The best of a grid of shifts, then the best near it; the rms may have several minima, a grid sees all."""
    # scipy takes a while to load, and only this needs it
    from scipy.optimize import minimize_scalar

    least = LEAST_OVERLAP * min(np.ptp(ours.t), np.ptp(theirs.t))

    def rms(seconds: float) -> float:
        start, end = max(ours.t[0], theirs.t[0] + seconds), min(ours.t[-1], theirs.t[-1] + seconds)
        if end - start < least:
            return np.inf
        inside = (ours.t >= start) & (ours.t <= end)
        error = np.interp(ours.t[inside], theirs.t + seconds, theirs.values) - ours.values[inside]
        return float(np.sqrt(np.mean(error**2))) if len(error) else np.inf

    step = max(limit / STEPS, min(limit, min(ours.sampling.period, theirs.sampling.period)))
    count = int(np.ceil(limit / step))
    grid = np.linspace(-limit, limit, 2 * count + 1)
    costs = np.array([rms(seconds) for seconds in grid])
    if not np.isfinite(costs).any():
        raise ComparisonRefused(
            f"--align fit: within {limit:g} s the logs overlap by less than half of the shorter; widen --max-shift, or "
            "try --align start"
        )
    # of equally good shifts the smallest
    best = min(range(len(grid)), key=lambda k: (costs[k], abs(grid[k])))
    low, high = grid[max(best - 1, 0)], grid[min(best + 1, len(grid) - 1)]
    refined = minimize_scalar(rms, bounds=(low, high), method="bounded", options={"xatol": 1e-3 * step})
    found = float(refined.x) if refined.fun < costs[best] else float(grid[best])
    note = f"the best shift is at the end of --max-shift {limit:g}; widen it" if best in (0, len(grid) - 1) else ""
    return TimeShift(found, note)
