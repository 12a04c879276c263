"""Comparison of one signal of two logs: its errors, and its departure from the tube."""

from dataclasses import dataclass

import numpy as np

from twin.kernel.recording.logs.log import LogSeries, in_gap
from twin.studies.compare.tolerance import Allowance, Curve, Tube, reach

LOST_SAMPLE = 2.0
"""Maximum spacing (periods) without a gap: half the rate, or an occasionally lost sample, leaves no hole."""


@dataclass(frozen=True)
class Exit:
    """First value of a signal outside its tolerance tube: time (s), value, and bounds at that time."""

    t: float
    value: float
    lower: float
    upper: float


@dataclass(frozen=True)
class SignalRow:
    """Comparison of one signal of two logs, SI: its errors and its departure from the tolerance tube.

    Errors are the second log's value less the first's, at the same time.

    Attributes:
        covered: share of the reference's time with values of the second log; see `coverage`.
        max_error, max_error_at: largest absolute error and its time (s).
        rms_error, mean_error: over the instants.
        span: range of the reference, the unit of shares.
        used: share of the tolerance used by the worst value, after the tolerance in time; inside is up to 1.
        outside: number of instants outside of the tube.
    """

    signal: str
    unit: str
    n: int
    covered: float
    max_error: float
    max_error_at: float
    rms_error: float
    mean_error: float
    span: float
    allowance: Allowance
    used: float
    outside: int
    first_exit: Exit | None
    inside: bool


@dataclass(frozen=True)
class TubeCurves:
    """Curves of one compared signal: instants t (s), values of both logs, reach and tolerance tube, all (n,)."""

    t: Curve
    a: Curve
    b: Curve
    reach: Tube
    tube: Tube


def tube_curves(ours: LogSeries, theirs: LogSeries, allowed: Allowance) -> TubeCurves:
    """Evaluate both logs' signal and its tube at the samples of the sparser log outside of gaps; n may be 0."""
    start, end = max(ours.t[0], theirs.t[0]), min(ours.t[-1], theirs.t[-1])
    count = [np.sum((series.t >= start) & (series.t <= end)) for series in (ours, theirs)]
    t = ours.t if count[0] <= count[1] else theirs.t
    t = t[(t >= start) & (t <= end) & ~in_gap(t, ours.sampling.gaps) & ~in_gap(t, theirs.sampling.gaps)]
    bounds = reach(ours.t, ours.values, t, allowed.dt)
    a, b = (np.interp(t, series.t, series.values) for series in (ours, theirs))
    return TubeCurves(t, a, b, bounds, bounds.widen(allowed.value))


def signal_row(
    signal: str, ours: LogSeries, theirs: LogSeries, allowed: Allowance, found: TubeCurves, span: float
) -> SignalRow:
    """Summarise the comparison of one signal, which has at least one common instant."""
    error = found.b - found.a
    # a NaN counts as an infinite error
    size = np.where(np.isfinite(error), np.abs(error), np.inf)
    worst = int(np.argmax(size))
    excess = np.abs(found.tube.excess(found.b))
    out = np.flatnonzero(excess > 0.0)
    first = None
    if len(out):
        k = out[0]
        first = Exit(*(float(x[k]) for x in (found.t, found.b, found.tube.lower, found.tube.upper)))
    off = float(np.max(np.abs(found.reach.excess(found.b))))
    used = off / allowed.value if allowed.value else (np.inf if len(out) else 0.0)
    return SignalRow(
        signal=signal,
        unit=ours.unit,
        n=len(found.t),
        covered=coverage(ours, theirs),
        max_error=float(size[worst]),
        max_error_at=float(found.t[worst]),
        rms_error=float(np.sqrt(np.mean(error**2))),
        mean_error=float(np.mean(error)),
        span=span,
        allowance=allowed,
        used=float(used),
        outside=len(out),
        first_exit=first,
        inside=first is None,
    )


def coverage(ours: LogSeries, theirs: LogSeries) -> float:
    """Return the share (0 .. 1) of one log signal's time that the other log's signal covers.

    A sampled signal begins up to a period after its source and ends up to a period before it, so a period of the
    coarser signal is tolerated at either end. Gaps of more than one lost sample count as holes, except where `ours` has
    a gap, too.
    """
    period = max(ours.sampling.period, theirs.sampling.period)
    # tolerance for the rounding of nanosecond stamps as doubles
    slack = period * (1.0 + 1e-6)
    start, end = float(ours.t[0]), float(ours.t[-1])
    early, late = float(theirs.t[0]) - start, end - float(theirs.t[-1])
    holes = theirs.sampling.gaps
    holes = holes[np.diff(holes, axis=1)[:, 0] > LOST_SAMPLE * slack]
    ends = [(start, start + early)] * (early > slack) + [(end - late, end)] * (late > slack)
    lost = np.clip(np.array([*ends, *holes]).reshape(-1, 2), start, end)
    # cumulated time of the own gaps, constant outside of them
    own = ours.sampling.gaps
    gone = np.repeat(np.cumsum([0.0, *np.diff(own, axis=1)[:, 0]]), 2)
    breaks = np.array([start, *own.ravel(), end])
    in_own = np.diff(np.interp(lost, breaks, gone), axis=1)
    missing = float(np.sum(np.diff(lost, axis=1) - in_own))
    return 1.0 if missing <= 0.0 else max(0.0, 1.0 - missing / (end - start - float(gone[-1])))
