"""A robot's log through the twin: estimate, plant model, residuals, and whether they still match.

The part of a log that says what is normal.

What a robot recorded, as the estimator takes it: encoder counts, and a measured force if there is one.

When does a residual leave what it was? Page's cumulative sum over means of blocks.

E. S. Page, Continuous inspection schemes, Biometrika 41 (1954) 100; the two-sided form and its run lengths as in D. C.
Montgomery, Introduction to Statistical Quality Control, sec. 9.1. With r_n the mean residual of block n and r_0 that of
the beginning of the log,

    up_n   = max(0, up_(n-1)   + (r_n - r_0) - K),     low_n = max(0, low_(n-1) - (r_n - r_0) - K),

and the alarm is the first sum beyond H. K = tolerance + sigma / 2 and H = 5 sigma: a residual that wanders within the
tolerance never fills a sum; one that stays just at its edge, with independent normal means of deviation sigma, does by
chance once in 930 blocks on one side (Montgomery, table 9.3: 465 for both sides of an in-control mean).

Neighbouring samples of a residual say the same thing twice, and a sum would take that for evidence. Blocks are at least
twice its correlation time T_c, and at least `SHORTEST_BLOCK`. sigma is the deviation of a block's mean: that of single
samples at the beginning times sqrt(2 T_c / block) (M. S. Bartlett, J. R. Stat. Soc. 8 (1946) 27, for an exponential
autocorrelation), but at least that of the sensors' own rounding: at rest an encoder shows one count for minutes, and no
spread at all.

How far two courses of one quantity are apart: bias, spread, when, how late one is, and what rounding explains.
"""

import math
import re
from collections.abc import Mapping
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from twin.kernel.cosim.delay import columns, play
from twin.kernel.errors import InputRefused
from twin.kernel.recording.logs.column_map import refuse_unit
from twin.kernel.recording.logs.log import Log, LogRefused, LogSeries, MappedColumn, in_gap, refuse_invalid, rows_of
from twin.robot.controller.controller import Belief, Estimator
from twin.robot.mechanism.statics import load_torque
from twin.studies.replay.model import RobotModel, motions
from twin.studies.replay.plausible import COUNTS, SCALE, MapCheck, as_counts

SHORTEST_BLOCK = 1.0
"""s. Two taps of a massage: the force of the platform's acceleration and of viscous joints comes to nothing over a
motion that returns to where it began."""
DECISION = 5.0
"""H / sigma."""


@dataclass(frozen=True)
class Drift:
    """What became of one residual, in its own unit.

    Attributes:
        baseline, sigma: its mean r_0 at the beginning, and the deviation of a block's mean.
        block: its length (s).
        tolerance: changes of the mean up to this are none.
        t, mean: end (s) and mean residual of each block, (n,);
        up, low: the sums after it, (n,).
        alarm: end of the block that raised it (s); NaN: none did.
        since: when the sum that raised it began to grow (s).
        size: mean residual less r_0 since then.
    """

    baseline: float
    sigma: float
    block: float
    tolerance: float
    t: NDArray[np.float64]
    mean: NDArray[np.float64]
    up: NDArray[np.float64]
    low: NDArray[np.float64]
    alarm: float
    since: float
    size: float

    @property
    def matches(self) -> bool:
        """Whether there was no alarm."""
        return bool(np.isnan(self.alarm))

    @property
    def slack(self) -> float:
        """K: how far a mean may be off before a sum begins to fill."""
        return self.tolerance + 0.5 * self.sigma

    @property
    def threshold(self) -> float:
        """H."""
        return DECISION * self.sigma


def drift(
    t: NDArray[np.float64], r: NDArray[np.float64], baseline: float, tolerance: float, sigma_least: float
) -> Drift | None:
    """The two-sided sum over a residual; None if there is no block after the beginning.

    Args:
        t, r: times (n,), s, ascending, and residual (n,).
        baseline: length of the beginning that says what is normal (s).
        tolerance: change of the mean that is no news, in the unit of r.
        sigma_least: deviation that the sensors' rounding alone amounts to, > 0, likewise.
    """
    first = t < t[0] + baseline
    normal = r[first]
    T_c = correlation_time(t[first], normal)
    block = max(SHORTEST_BLOCK, 2.0 * T_c)
    r_0, sigma = float(np.mean(normal)), max(float(np.std(normal)) * np.sqrt(2.0 * T_c / block), sigma_least)
    ends, mean = _block_means(t[~first], r[~first], block)
    if not len(ends):
        return None
    K, H = tolerance + 0.5 * sigma, DECISION * sigma
    up, low = _sum(mean - r_0 - K), _sum(r_0 - mean - K)
    over = np.flatnonzero((up > H) | (low > H))
    alarm = since = size = np.nan
    if len(over):
        n = int(over[0])
        own = up if up[n] > H else low
        begun = int(np.max(np.flatnonzero(own[: n + 1] == 0.0), initial=-1)) + 1
        alarm, since = float(ends[n]), float(ends[begun] - block)
        size = float(np.mean(mean[begun : n + 1])) - r_0
    return Drift(r_0, sigma, block, tolerance, ends, mean, up, low, alarm, since, size)


def correlation_time(t: NDArray[np.float64], r: NDArray[np.float64]) -> float:
    """Lag (s) at which the autocorrelation of r (n,) falls below 1/e; 0 for a residual that stands still.

    A beginning that is all one swing gives at most its own length.
    """
    centred = r - np.mean(r)
    if len(r) < 3 or not np.any(centred):
        return 0.0
    # padded to twice its length, so that its end does not meet its beginning
    power = np.abs(np.fft.rfft(centred, 2 * len(r))) ** 2
    autocorrelation = np.fft.irfft(power, 2 * len(r))[: len(r)] / np.sum(centred**2)
    below = np.flatnonzero(autocorrelation < np.exp(-1.0))
    return float(np.median(np.diff(t))) * float(below[0] if len(below) else len(r))


def _sum(steps: NDArray[np.float64]) -> NDArray[np.float64]:
    """sum_n = max(0, sum_(n-1) + steps_n)."""
    total = np.cumsum(steps)
    # as far above its deepest point so far as it is
    return total - np.minimum(0.0, np.minimum.accumulate(total))


def _block_means(
    t: NDArray[np.float64], r: NDArray[np.float64], block: float
) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
    """End (s) and mean of each whole block that has at least half the samples of the fullest one."""
    if not len(t):
        return np.empty(0), np.empty(0)
    index = np.floor((t - t[0]) / block).astype(np.int64)
    # the last one is whole only by chance
    whole = index < index[-1]
    # only blocks with samples: a log may have hours without one
    blocks, member, count = np.unique(index[whole], return_inverse=True, return_counts=True)
    full = count >= 0.5 * np.max(count, initial=0)
    sums = np.bincount(member, weights=r[whole], minlength=len(blocks))
    return t[0] + (blocks[full] + 1) * block, sums[full] / count[full]


LONGEST_LAG = 0.5
"""s. Beyond that two courses of a repeated motion match by mistake."""
FINEST_LAG = 5e-3
"""s. What a force that changes within tenths of a second, with noise on it, can tell at best."""
MOST_LAGGED = 2_000_000
"""Sample periods over which a lag is looked for: some hours."""
STALE = 1.5
"""Sample periods after which an estimate is no longer the newest: one was lost."""


@dataclass(frozen=True)
class Residual:
    """Differences `value - measured` at times.

    Attributes:
        t: of the measurements that have a value beside them (n,), s.
        value, measured: (n,), both in the unit of the quantity.
    """

    t: NDArray[np.float64]
    value: NDArray[np.float64]
    measured: NDArray[np.float64]

    @property
    def r(self) -> NDArray[np.float64]:
        """Value less measured, (n,)."""
        return self.value - self.measured


@dataclass(frozen=True)
class Statistics:
    """A residual in numbers, in the quantity's own unit.

    Attributes:
        bias, std, rms: mean, standard deviation about it, root mean square.
        largest, at: the residual of greatest size, with its sign, and when (s).
        correlation: Pearson's, of value and measurement; NaN where one of them stands still.
        lag: how much later the value is than the measurement (s), the peak of their cross-correlation; NaN likewise.
    """

    bias: float
    std: float
    rms: float
    largest: float
    at: float
    correlation: float
    lag: float


def residual(
    t: NDArray[np.float64],
    values: NDArray[np.float64],
    gaps: NDArray[np.float64],
    t_measured: NDArray[np.float64],
    measured: NDArray[np.float64],
) -> Residual:
    """`values` beside the measurements: at each, the newest value of that moment, unless it is stale or from a gap.

    Args:
        t: times of the values (n,), s, ascending.
        values: (n,).
        gaps: intervals (k, 2), s, in which values are missing.
        t_measured, measured: times and values of the measurement (m,).
    """
    newest = np.searchsorted(t, t_measured, side="right") - 1
    age = t_measured - t[np.maximum(newest, 0)]
    use = (newest >= 0) & (age < STALE * np.median(np.diff(t))) & ~in_gap(t_measured, gaps)
    return Residual(t_measured[use], values[newest[use]], measured[use])


def statistics(residual: Residual) -> Statistics:
    """Of a residual with at least two entries."""
    r = residual.r
    worst = int(np.argmax(np.abs(r)))
    moves = min(np.ptp(residual.value), np.ptp(residual.measured)) > 0.0
    return Statistics(
        bias=float(np.mean(r)),
        std=float(np.std(r)),
        rms=float(np.sqrt(np.mean(r**2))),
        largest=float(r[worst]),
        at=float(residual.t[worst]),
        correlation=float(np.corrcoef(residual.value, residual.measured)[0, 1]) if moves else np.nan,
        lag=_lag(residual) if moves else np.nan,
    )


def _lag(residual: Residual) -> float:
    """The shift (s) under which value and measurement spread least about each other; NaN: not known, because most of
    what would be looked at is missing."""
    period = max(float(np.median(np.diff(residual.t))), FINEST_LAG)
    if np.ptp(residual.t) > MOST_LAGGED * period:
        return np.nan
    grid = np.arange(residual.t[0], residual.t[-1] + 0.5 * period, period)
    value = np.interp(grid, residual.t, residual.value)
    measured = np.interp(grid, residual.t, residual.measured)
    most = min(int(LONGEST_LAG / period), len(grid) // 4)
    # the same stretch of the measurement for every shift, so that none has an easier one
    core = measured[most : len(measured) - most]
    spread = [np.std(value[most + k : most + k + len(core)] - core) for k in range(-most, most + 1)]
    return period * (int(np.argmin(spread)) - most)


class Rounding(NamedTuple):
    """What the sensors' rounding alone makes of a residual, in its own unit: smaller differences cannot be seen.

    Each encoder is off by up to half a count and, over poses, evenly distributed in that range: a deviation of
    1/sqrt(12) count. At rest it does not average out.

    Attributes:
        bound: with every sensor half a step off, all in the same sense.
        deviation: with every sensor off at random.
    """

    bound: float
    deviation: float


def force_rounding(belief: Belief, J: NDArray[np.float64], resolution: float) -> Rounding:
    """Of estimated less measured pressing force (N), at the worst pose of a log.

    F_z = -e_z J^T tau_l with tau_l = k_s N eta (theta_m - N theta_l), Eq. 19 to 21.

    Args:
        belief: the estimator's.
        J: Jacobians (n, 9), rad/m, row by row.
        resolution: of the measurement (N).
    """
    of_z = np.abs(J[:, 2::3]) * load_torque(belief.k_s, belief.N, belief.eta, 1.0)
    motor, joint = _counts(belief)
    bound = np.max(np.sum(of_z, axis=1)) * (motor + belief.N * joint) / 2.0 + resolution / 2.0
    variance = np.max(np.sum(of_z**2, axis=1)) * (motor**2 + (belief.N * joint) ** 2) + resolution**2
    return Rounding(float(bound), float(np.sqrt(variance / 12.0)))


def angle_rounding(belief: Belief) -> Rounding:
    """Of a joint angle of the plant model less that of the log (rad): a free link follows its motor, theta_m / N."""
    motor, joint = _counts(belief)
    return Rounding((motor / belief.N + joint) / 2.0, float(np.hypot(motor / belief.N, joint) / np.sqrt(12.0)))


def _counts(belief: Belief) -> tuple[float, float]:
    """A count of the motor and of the joint encoders, rad."""
    return 2.0 * np.pi / belief.motor_counts, 2.0 * np.pi / belief.joint_counts


def normal_time(text: str) -> tuple[float, float]:
    """(from, to) in s after the log's first sample: `2` is 0 to 2, `1:3` leaves the first second out.

    Raises:
        InputRefused: no such times.
    """
    first, colon, last = text.rpartition(":")
    try:
        begin, end = float(first) if colon else 0.0, float(last)
    except ValueError:
        begin = end = math.nan
    if not (math.isfinite(end) and 0.0 <= begin < end):
        raise InputRefused(f"--baseline {text}: expected a time > 0 s, or FROM:TO with 0 <= FROM < TO, for example 1:3")
    return begin, end


LONGEST = 1e8
"""s; three years, the longest log."""
MANY = 12
"""So many names are not listed in a sentence."""


@dataclass(frozen=True)
class RobotLog:
    """Encoders and force sensor.

    Attributes:
        path: of the file.
        t: times of the encoders' samples (n,), s, ascending.
        count_m, count_l: counts (n, 3); of a log of angles they are no whole numbers.
        gaps: start and end (s) of each interval in which samples are missing, (k, 2).
        missing: how many are.
        force: measured pressing force (N); None: the log has none.
        notes: what was wrong with the file, one sentence each.
        columns: see `Log`.
    """

    path: Path
    t: NDArray[np.float64]
    count_m: NDArray[np.float64]
    count_l: NDArray[np.float64]
    gaps: NDArray[np.float64]
    missing: int
    force: LogSeries | None
    notes: tuple[str, ...]
    columns: Mapping[str, MappedColumn] = field(default_factory=dict)

    @property
    def period(self) -> float:
        """Median time between samples, s."""
        return float(np.median(np.diff(self.t)))


def robot_log(log: Log, belief: Belief) -> RobotLog:
    """The encoders and the measured force of `log`.

    Encoders: `encoder.count_m[0..2]`, `encoder.count_l[0..2]` (1), or `estimator.theta_m`, `estimator.theta_l` (rad)
    in the place of either. Of a recording with faulty encoders, what the computer received: the last /fault/n that
    carries counts. Measured force: `scale.F_z` (N), pressing positive. Samples of the encoders belong together as
    `rows_of` has it; a time at which one of the six has none is left out.

    Args:
        log: as `read_log` gives it.
        belief: turns angles into counts.

    Raises:
        LogRefused: no encoders, other units, motor and joint encoders at different times, times before 0, or more than
            `MAX_INVALID` of the samples of an encoder are invalid.
    """
    sides = [_counts_in(log, name, belief) for name in COUNTS]
    counts = rows_of(sides)
    if 2 * len(counts.t) < min(len(one.t) for one in sides) or len(counts.t) < 2:
        raise LogRefused(
            f"{log.path}: motor and joint encoders have different times; expected one sample of both at each, less "
            "than half a period apart"
        )
    refuse_invalid(log.path, "an encoder", len(counts.invalid), len(counts.invalid) + len(counts.t))
    lost = max(len(one.t) for one in sides) - len(counts.t)
    notes = (*log.notes, f"{lost} samples without all six encoders are left out") if lost else log.notes
    count_m, count_l = (replace(counts, values=values) for values in (counts.values[:, :3], counts.values[:, 3:]))
    measured = _in_unit(log, SCALE, log[SCALE], "N") if SCALE in log.series else None
    if count_m.t[0] < 0.0:
        raise LogRefused(f"{log.path}: begins at {count_m.t[0]:g} s, before 0; count its time from its first sample")
    if count_m.t[-1] > LONGEST:
        raise LogRefused(f"{log.path}: ends at {count_m.t[-1]:g} s, expected at most {LONGEST:g} s; is its unit right?")
    # a count that never came is the estimator's business; before the first there is nothing to hold
    there = np.all(np.isfinite(count_m.values + count_l.values), axis=1)
    if not np.any(there):
        raise LogRefused(f"{log.path}: not one sample has all six counts")
    first = int(np.argmax(there))
    gaps, missing = count_m.sampling.gaps, count_m.sampling.missing
    counts_m, counts_l = count_m.values[first:], count_l.values[first:]
    return RobotLog(log.path, count_m.t[first:], counts_m, counts_l, gaps, missing, measured, notes, log.columns)


def _counts_in(log: Log, name: str, belief: Belief) -> LogSeries:
    """Counts (n, 3) of the motor or the joint encoders."""
    angle = f"estimator.{COUNTS[name]}"
    faults = [int(m[1]) for key in log.series if (m := re.fullmatch(rf"fault/(\d+)\.{name}\[0\]", key))]
    counts = f"fault/{max(faults)}.{name}" if faults else f"encoder.{name}"
    there = {name.rpartition("[")[0] for name in (*log.series, *log.left_out)}
    if counts in there:
        return _three(log, counts, "1")
    if angle not in there:
        has = list(log.series)
        raise LogRefused(
            f"{log.path}: neither {counts}[0..2] nor {angle}[0..2] is there; it has {', '.join(has[:MANY])}"
            f"{' ...' if len(has) > MANY else ''}; choose with --map '{angle}[0]=COLUMN[deg]' and so on"
        )
    series = _three(log, angle, "rad")
    # what `estimator.angle` takes off again
    zero, per_rad = as_counts(name, belief)
    return replace(series, values=(series.values + np.array(zero)) * per_rad, unit="1")


def _three(log: Log, name: str, unit: str) -> LogSeries:
    series = log.vector(name)
    if series.values.shape[1] != 3:
        raise LogRefused(f"{log.path}: {name} has {series.values.shape[1]} components, expected 3, one per joint")
    return _in_unit(log, name, series, unit)


def _in_unit(log: Log, name: str, series: LogSeries, unit: str) -> LogSeries:
    refuse_unit(f"{log.path}:", name, series.unit, unit)
    return series


Outputs = dict[str, NDArray[np.float64]]
FEWEST = 20
"""Samples of the beginning that tell what is normal."""


@dataclass(frozen=True)
class Indicator:
    """One way in which the twin can stop matching.

    Attributes:
        name: `force`, or `joint 1` .. `joint 3`.
        unit: `N` or `rad`.
        t, r: the residual's times (n,), s, and values (n,).
        drift: what became of it.
    """

    name: str
    unit: str
    t: NDArray[np.float64]
    r: NDArray[np.float64]
    drift: Drift


@dataclass(frozen=True)
class Replay:
    """Everything a replay gives, SI.

    Attributes:
        model, log: what was put in.
        estimator: outputs of the controller's estimator at the log's samples, by port.
        twin: likewise with the dead zone taken off as the plant has it; the same object where the belief knows it.
        plant: the plant model's; None: not asked for.
        starts: when it started (s).
        forces: F_z of `estimator`, `twin` and `plant` beside the measured force; empty without one.
        indicators: force first; empty: nothing independent of the encoders to compare with.
    """

    model: RobotModel
    log: RobotLog
    estimator: Outputs
    twin: Outputs
    plant: Outputs | None
    starts: tuple[float, ...]
    forces: dict[str, Residual]
    indicators: tuple[Indicator, ...]

    @property
    def statistics(self) -> dict[str, Statistics]:
        """Of `forces`."""
        return {name: statistics(one) for name, one in self.forces.items()}

    @property
    def first_alarm(self) -> Indicator | None:
        """The indicator that was the first to say that twin and robot part; None: none did."""
        drifted = [one for one in self.indicators if not one.drift.matches]
        return min(drifted, key=lambda one: one.drift.alarm, default=None)


def replayed(
    log: Log,
    model: RobotModel,
    plant: bool = False,
    baseline: tuple[float, float] = (0.0, 1.0),
    tolerance: float | None = None,
) -> Replay:
    """Put `log` through the twin `model`.

    The verdict on the force is that of the estimate with the dead zone taken off: the paper's estimator is blind to
    it, and its error changes by twice the dead zone's torque where a spring changes sides, on a healthy robot, too.

    Args:
        log: of a robot or a run.
        model: what is believed of it.
        plant: let the plant model run in parallel.
        baseline: (from, to) after the first sample that says what is normal (s); the robot should be in free air. What
            is before that is not judged.
        tolerance: change of the mean force residual that is no news (N); None: what rounding alone can do.

    Raises:
        InputRefused: a log that is not one of a robot, or too short for the baseline.
        ComponentFailed: the plant model left the workspace.
    """
    robot = robot_log(log, model.belief)
    _refuse_lengths(robot, baseline, tolerance)
    estimator = estimates(robot, model.belief, model.gravity_compensation)
    best = estimator
    if model.aware != model.belief:
        best = estimates(robot, model.aware, model.gravity_compensation)
    motion, starts = motions(model, robot.t, best["theta_m"], best["p_B"]) if plant else (None, [])
    forces, indicators = {}, []
    if robot.force is not None:
        courses = {"estimator": estimator} | ({} if best is estimator else {"twin": best})
        courses |= {"plant": motion} if motion else {}
        t, measured = robot.force.t, robot.force.values
        forces = {name: residual(robot.t, pressing(one), robot.gaps, t, measured) for name, one in courses.items()}
        judged = forces.get("twin", forces["estimator"])
        if len(judged.t) < FEWEST:
            raise InputRefused(f"{robot.path}: {len(judged.t)} measured forces while the encoders were there; too few")
        rounding = force_rounding(model.aware, best["J"], model.resolution)
        bound = rounding.bound if tolerance is None else tolerance
        indicators += _indicator("force", "N", judged.t, judged.r, baseline, bound, rounding.deviation)
    if motion:
        angle = angle_rounding(model.aware)
        for i in range(3):
            r = motion["theta_l"][:, i] - best["theta_l"][:, i]
            indicators += _indicator(f"joint {i + 1}", "rad", robot.t, r, baseline, angle.bound, angle.deviation)
    return Replay(model, robot, estimator, best, motion, tuple(starts), forces, tuple(indicators))


def estimates(log: RobotLog, belief: Belief, gravity_compensation: bool) -> Outputs:
    """The estimator's outputs by port at every sample of `log`: (n,) or (n, size), SI.

    The component of a run is stepped; it keeps nothing from sample to sample but the last valid estimate, so a gap in
    the log costs the samples in it and no others.

    Raises:
        LogRefused: the first sample fits no pose of the robot, so there is nothing to hold; or the columns of a log are
            not the signals that its map says.
    """
    check = MapCheck(str(log.path), belief, log.columns)
    component = Estimator(belief, gravity_compensation)
    rows, status = play(component, log.t, np.full(len(log.t), log.period), np.hstack([log.count_m, log.count_l]))
    mistake = check.first(log.count_m[0], log.count_l[0]) if status or log.columns else ""
    found = columns(component, rows)
    if not mistake:
        check.add(found["theta_m"], found["theta_l"])
        if log.force is not None:
            beside = residual(log.t, pressing(found), log.gaps, log.force.t, log.force.values)
            check.add_force(beside.value, beside.measured)
    if mistake := mistake or check.mistake:
        raise LogRefused(mistake)
    return found


def pressing(outputs: Outputs) -> NDArray[np.float64]:
    """Pressing force F_z (n,), N, of an estimator or a plant."""
    return -outputs["F_ee_B"][:, 2]


def _indicator(
    name: str, unit: str, t: NDArray[np.float64], r: NDArray[np.float64], baseline: tuple[float, float],
    tolerance: float, deviation: float,
) -> list[Indicator]:  # fmt: skip
    judged = t >= t[0] + baseline[0]
    t, r = t[judged], r[judged]
    found = drift(t, r, baseline[1] - baseline[0], tolerance, deviation) if len(t) else None
    return [Indicator(name, unit, t, r, found)] if found else []


def _refuse_lengths(robot: RobotLog, baseline: tuple[float, float], tolerance: float | None) -> None:
    if tolerance is not None and not tolerance >= 0.0:
        raise InputRefused(f"--tolerance {tolerance:g}: expected a force >= 0 N")
    span = robot.t[-1] - robot.t[0]
    begin, end = baseline
    after = robot.t - robot.t[0]
    within = int(np.sum((after >= begin) & (after < end)))
    if span <= end or within < FEWEST:
        which = f"from {begin:g} to {end:g} s" if begin else f"in the first {end:g} s"
        raise InputRefused(
            f"{robot.path}: {span:.3g} s with {within} samples {which}; expected at least {FEWEST} "
            "there and more after them; choose with --baseline S or --baseline FROM:TO"
        )
