"""Metrics of a signal: step response, tracking error, oscillation, path, effort.

Definitions of the step response, for y from its value y_0 before the
step to its final value y_inf, share = (y - y_0) / (y_inf - y_0): delay and rise times run between first crossings of
10, 50 and 90 % of the share, between samples on a straight line (as in IEEE 181); settling times end where the share
stays within 2 or 5 % of 1, seen for at least the last tenth of the samples; overshoot is the largest share beyond 1
(terms as in IEC 60050-351). The errors are against the reference, e = r - y: IAE, ISE and ITAE are the integrals of
|e|, e^2 and t |e| from the step to the end of the samples.

A share needs a final value, so a response that is still on its way is refused rather than measured.
"""

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from twin.kernel.errors import InputRefused

Curve = NDArray[np.float64]
TAIL_SHARE = 0.1
"""Share of the samples at the end over which the final value is a mean."""
SETTLED_BAND = 0.05
"""A response has settled if it stays this near to its final value (share of the step) for twice the tail."""
MIN_PERIODS = 4
"""Minimum number of periods of the slowest swing in a window: half the width of a Hann window's main lobe is
2 / window, so the remainder of a drift has decayed at that frequency."""
PADDING_FACTOR = 8
"""Padded length by the window's length: a sine between two frequencies loses less than 0.3 % of its amplitude."""


def window_mask(t: Curve, start: float, end: float) -> NDArray[np.bool_]:
    """Mark the samples with start <= t <= end (s), with half a nanosecond of tolerance for rounding."""
    return (t >= start - 5e-10) & (t <= end + 5e-10)


def settling_time(t: Curve, y: Curve, target: float, band: float) -> float:
    """Return the start (s) of the final stretch with |y - target| <= band; infinity if the last sample is outside."""
    outside = np.flatnonzero(np.abs(y - target) > band)
    if len(outside) == 0:
        return float(t[0])
    return float(t[outside[-1] + 1]) if outside[-1] + 1 < len(t) else np.inf


def first_time(t: Curve, condition: NDArray[np.bool_]) -> float:
    """Return the time (s) of the first sample with a true `condition`; infinity if every sample is false."""
    hits = np.flatnonzero(condition)
    return float(t[hits[0]]) if len(hits) else np.inf


def overshoot(y: Curve, target: float) -> float:
    """Compute the largest excess of y over a positive target, as a share of the target; 0 without an excess."""
    return max(0.0, float(np.max(y)) / target - 1.0)


def rise_time(t: Curve, y: Curve, before: float, after: float) -> float:
    """Compute the 10 % to 90 % rise time (s) of y between `before` and `after`; infinity if y never reaches 90 %."""
    share = (y - before) / (after - before)
    return first_time(t, share >= 0.9) - first_time(t, share >= 0.1)


def steepest_rise(t: Curve, y: Curve, span: float) -> float:
    """Compute the largest mean rate of evenly spaced y (n,) over any `span` (s); infinity for shorter samples."""
    steps = round(span / (t[1] - t[0])) if len(t) > 1 else 0
    if not 0 < steps < len(t):
        return np.inf
    return float(np.max((y[steps:] - y[:-steps]) / (t[steps:] - t[:-steps])))


@dataclass(frozen=True)
class StepInfo:
    """Metrics of a response to a step at t = 0; times in s, values in the unit of y.

    Attributes:
        final: y_inf.
        peak: extreme value of y in the direction of the step.
        peak_time: time of the peak.
        delay_time: time to 50 % of the step.
        rise_time: time from 10 to 90 % of the step.
        settling_time_2, settling_time_5: time from which y stays within 2 or 5 %; infinity if it leaves the band within
            the last tenth, as a limit cycle does.
        overshoot: overshoot as a share of the step.
        steady_state_error: r - y_inf.
        IAE, ISE, ITAE: unit times s, unit squared times s, unit times s squared.
    """

    final: float
    peak: float
    peak_time: float
    delay_time: float
    rise_time: float
    settling_time_2: float
    settling_time_5: float
    overshoot: float
    steady_state_error: float
    IAE: float
    ISE: float
    ITAE: float


def step_info(t: Curve, y: Curve, before: float, reference: float) -> StepInfo:
    """Compute the metrics of the response y to a step of its reference at t = 0.

    Args:
        t: s, ascending, from 0 on (n,).
        y: samples (n,).
        before: y_0.
        reference: r, constant after the step.
    """
    if len(t) < 20:
        raise InputRefused(f"a step response of {len(t)} samples: expected 20 or more; record longer or faster")
    if reference == before:
        raise InputRefused(f"a step from {before:g} to {reference:g}: no step")
    tail = max(2, round(TAIL_SHARE * len(t)))
    final = float(np.mean(y[-tail:]))
    step = final - before
    if abs(step) < SETTLED_BAND * abs(reference - before):
        raise InputRefused(
            f"no response to the step from {before:g} to {reference:g}: in the end it is {final:g}, moved less than "
            f"{100 * SETTLED_BAND:g} % of the step"
        )
    rest = float(np.max(np.abs(y[-2 * tail :] - final)))
    if rest > SETTLED_BAND * abs(step):
        raise InputRefused(
            f"the step response has not settled: in its last {t[-1] - t[-2 * tail]:.3g} s it is still {rest:.3g} from "
            f"its end, {100 * rest / abs(step):.0f} % of the step, "
            f"expected at most {100 * SETTLED_BAND:g} %; simulate longer"
        )
    share = (y - before) / step
    farthest = int(np.argmax(share))
    settled_2, settled_5 = (settling_time(t, share, 1.0, band) for band in (0.02, 0.05))
    e = reference - y
    return StepInfo(
        final=final,
        peak=float(y[farthest]),
        peak_time=float(t[farthest]),
        delay_time=crossing_time(t, share, 0.5),
        rise_time=crossing_time(t, share, 0.9) - crossing_time(t, share, 0.1),
        settling_time_2=settled_2 if settled_2 <= t[-tail] else np.inf,
        settling_time_5=settled_5 if settled_5 <= t[-tail] else np.inf,
        overshoot=overshoot(share, 1.0),
        steady_state_error=reference - final,
        IAE=float(np.trapezoid(np.abs(e), t)),
        ISE=float(np.trapezoid(e**2, t)),
        ITAE=float(np.trapezoid(t * np.abs(e), t)),
    )


def crossing_time(t: Curve, y: Curve, level: float) -> float:
    """Return the time at which y first rises to `level`, interpolated linearly between samples; infinity if never."""
    above = np.flatnonzero(y >= level)
    if len(above) == 0:
        return np.inf
    k = int(above[0])
    if k == 0:
        return float(t[0])
    return float(t[k - 1] + (level - y[k - 1]) / (y[k] - y[k - 1]) * (t[k] - t[k - 1]))


def rms(x: Curve) -> float:
    return float(np.sqrt(np.mean(np.square(x))))


def mean_error(y: Curve, reference: Curve | float) -> float:
    """Compute the mean absolute error, the mean of |y - reference|."""
    return float(np.mean(np.abs(y - reference)))


def level_changes(t: Curve, y: Curve, span: float) -> tuple[Curve, Curve]:
    """Compute the change of the mean level at each time: mean of y over `span` (s) after it less the mean over `span`
    before. Return (times, changes).

    Args:
        t, y: evenly spaced samples, for longer than twice the span (n,).
    """
    steps = round(span / (t[1] - t[0]))
    sums = np.concatenate([[0.0], np.cumsum(y)])
    means = (sums[steps:] - sums[:-steps]) / steps
    changes = means[steps:] - means[:-steps]
    return t[steps : steps + len(changes)], changes


def lag(t: Curve, y: Curve, reference: Curve, longest: float) -> float:
    """Estimate the delay (s) of y behind its reference, between 0 and `longest`, by the least mean square difference.

    The minimum over whole samples is refined by the vertex of the parabola through that sample and its neighbours
    (Jacovitti and Scarano, Discrete time techniques for time delay estimation, IEEE Trans. Signal Processing 41, 1993:
    average square difference function).

    Args:
        t: evenly spaced, for longer than `longest` (n,).
        y, reference: (n,).
    """
    step, n = t[1] - t[0], len(t)
    most = round(longest / step)
    # a sample beyond either end, which the parabola needs
    delays = np.arange(-1, most + 2)
    error = np.array([np.mean((y[most + 1 : n - 1] - reference[most + 1 - k : n - 1 - k]) ** 2) for k in delays])
    best = 1 + int(np.argmin(error[1:-1]))
    before, least, after = error[best - 1 : best + 2]
    bend = before - 2.0 * least + after
    vertex = 0.5 * (before - after) / bend if bend > 0.0 else 0.0
    return float(step * np.clip(delays[best] + np.clip(vertex, -0.5, 0.5), 0, most))


def path_error(p: Curve, path: Curve) -> Curve:
    """Compute the distance of each point to the nearest place of a path, at any time, (n,) in the points' unit.

    Args:
        p: points (n, d).
        path: corners of the path (m, d), close together where it bends.
    """
    from scipy.spatial import KDTree

    # where the path rests, a corner would have no way to its neighbour
    path = path[np.append(True, np.any(np.diff(path, axis=0) != 0.0, axis=1))]
    _, nearest = KDTree(path).query(p)
    before = _to_segment(p, path[np.maximum(nearest - 1, 0)], path[nearest])
    after = _to_segment(p, path[nearest], path[np.minimum(nearest + 1, len(path) - 1)])
    return np.minimum(before, after)


def _to_segment(p: Curve, a: Curve, b: Curve) -> Curve:
    """Compute the distances (n,) of points to line segments from a to b, each (n, d)."""
    way = b - a
    length2 = np.sum(way**2, axis=1)
    share = np.divide(np.sum((p - a) * way, axis=1), length2, out=np.zeros(len(p)), where=length2 > 0.0)
    return np.linalg.norm(p - a - np.clip(share, 0.0, 1.0)[:, None] * way, axis=1)


def strongest_swing(t: Curve, y: Curve, lowest: float) -> tuple[float, float]:
    """Find the strongest sine in y, and return its (amplitude, frequency) in the unit of y and Hz. A straight line is
    subtracted first.

    The largest value of the amplitude spectrum with a Hann window (Harris, On the use of windows for harmonic analysis
    with the discrete Fourier transform, Proc. IEEE 66, 1978). A swing that dies away counts with its mean over the
    window, weighted by that.

    Args:
        t, y: evenly spaced samples (n,) over at least `MIN_PERIODS` periods of `lowest`.
        lowest: minimum frequency of a swing (Hz).
    """
    from scipy.signal import periodogram

    f, power = periodogram(
        y, 1.0 / (t[1] - t[0]), window="hann", nfft=PADDING_FACTOR * len(y), detrend="linear", scaling="spectrum"
    )
    slow = f < lowest
    power[slow] = 0.0
    best = int(np.argmax(power))
    # of a sine of amplitude a the spectrum holds a^2 / 2
    return float(np.sqrt(2.0 * power[best])), float(f[best])


def fitted_circle(x: Curve, y: Curve) -> tuple[float, float, float]:
    """Fit a circle to points by least squares; return centre and radius (x_c, y_c, r) in their unit.

    Least squares of x^2 + y^2 = 2 x_c x + 2 y_c y + (r^2 - x_c^2 - y_c^2), linear in the brackets (Kasa 1976). On
    points all round the circle that has no bias; on a short, noisy arc r comes out too small.

    Args:
        x, y: at least three points that are not on a line (n,).
    """
    known = np.column_stack([2.0 * x, 2.0 * y, np.ones_like(x)])
    (x_c, y_c, rest), *_ = np.linalg.lstsq(known, x**2 + y**2, rcond=None)
    return float(x_c), float(y_c), float(np.sqrt(rest + x_c**2 + y_c**2))


def turns_about(x: Curve, y: Curve, centre: tuple[float, float]) -> float:
    """Count the counter-clockwise turns of a path about `centre`; successive points are less than half a turn apart."""
    angle = np.unwrap(np.arctan2(y - centre[1], x - centre[0]))
    return float(angle[-1] - angle[0]) / (2.0 * np.pi)


def along_and_off(p: Curve, start: tuple[float, float], end: tuple[float, float]) -> tuple[Curve, Curve]:
    """Split points (n, 2) into distance along the line from `start` to `end`, and distance to its left, each (n,)."""
    direction = np.subtract(end, start) / np.linalg.norm(np.subtract(end, start))
    way = p - np.asarray(start)
    return way @ direction, way @ np.array([-direction[1], direction[0]])


def travel(t: Curve, rate: Curve) -> float:
    """Compute the control effort, the integral of |rate| over time, summed over the columns of (n, k)."""
    return float(np.sum(np.trapezoid(np.abs(rate), t, axis=0)))


def work(t: Curve, torque: Curve, speed: Curve) -> tuple[float, float]:
    """Compute the work (J) of shafts on their loads: (delivered, returned), integrals of positive and negative power.

    Args:
        t: s (n,).
        torque, speed: N m that opposes positive speed, rad/s, (n, k).
    """
    power = torque * speed
    delivered = np.sum(np.trapezoid(np.maximum(power, 0.0), t, axis=0))
    return float(delivered), float(-np.sum(np.trapezoid(np.minimum(power, 0.0), t, axis=0)))


def variation(x: Curve) -> float:
    """Compute the coefficient of variation of a sample (n,), its standard deviation by its mean."""
    return float(np.std(x) / np.mean(x))
