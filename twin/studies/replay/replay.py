"""A robot's log through the twin: estimate, plant model, residuals, and whether they still match.

The part of a log that says what is normal.

What a robot recorded, as the estimator takes it: encoder counts, and a measured force if there is one.
"""

import math
import re
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from twin.kernel.cosim.delay import columns, play
from twin.kernel.errors import InputRefused
from twin.kernel.recording.logs.log import Log, LogRefused, LogSeries
from twin.kernel.units import known_unit, weight_hint
from twin.robot.controller.controller import Belief, Estimator, angle
from twin.studies.replay.drift import (
    Drift,
    Residual,
    Statistics,
    angle_rounding,
    drift,
    force_rounding,
    residual,
    statistics,
)
from twin.studies.replay.model import RobotModel, motions


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


SCALE = "scale.F_z"
COUNTS = {"count_m": "theta_m", "count_l": "theta_l"}
"""The counts of the motor and joint encoders, and the angles that a log may have in their place."""
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
    """

    path: Path
    t: NDArray[np.float64]
    count_m: NDArray[np.float64]
    count_l: NDArray[np.float64]
    gaps: NDArray[np.float64]
    missing: int
    force: LogSeries | None
    notes: tuple[str, ...]

    @property
    def period(self) -> float:
        """Median time between samples, s."""
        return float(np.median(np.diff(self.t)))


def robot_log(log: Log, belief: Belief) -> RobotLog:
    """The encoders and the measured force of `log`.

    Encoders: `encoder.count_m[0..2]`, `encoder.count_l[0..2]` (1), or `estimator.theta_m`, `estimator.theta_l` (rad)
    in the place of either. Of a recording with faulty encoders, what the computer received: the last /fault/n that
    carries counts. Measured force: `scale.F_z` (N), pressing positive.

    Args:
        log: as `read_log` gives it.
        belief: turns angles into counts.

    Raises:
        LogRefused: no encoders, other units, motor and joint encoders at different times, or times before 0.
    """
    count_m, count_l = (_counts(log, name, belief) for name in COUNTS)
    if not np.array_equal(count_m.t, count_l.t):
        raise LogRefused(
            f"{log.path}: motor and joint encoders have different times; expected one sample of both at each"
        )
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
    return RobotLog(
        log.path, count_m.t[first:], count_m.values[first:], count_l.values[first:], gaps, missing, measured, log.notes
    )


def _counts(log: Log, name: str, belief: Belief) -> LogSeries:
    """Counts (n, 3) of the motor or the joint encoders."""
    angle = f"estimator.{COUNTS[name]}"
    faults = [int(m[1]) for key in log.series if (m := re.fullmatch(rf"fault/(\d+)\.{name}\[0\]", key))]
    counts = f"fault/{max(faults)}.{name}" if faults else f"encoder.{name}"
    if f"{counts}[0]" in log.series:
        return _three(log, counts, "1")
    if f"{angle}[0]" not in log.series:
        has = list(log.series)
        raise LogRefused(
            f"{log.path}: neither {counts}[0..2] nor {angle}[0..2] is there; it has {', '.join(has[:MANY])}"
            f"{' ...' if len(has) > MANY else ''}; choose with --map '{angle}[0]=COLUMN[deg]' and so on"
        )
    series = _three(log, angle, "rad")
    # counts per turn and zeros (rad): what `estimator.angle` takes off again
    of_motor = name == "count_m"
    turn, zero = (belief.motor_counts, belief.motor_zero) if of_motor else (belief.joint_counts, belief.joint_zero)
    return LogSeries(series.t, (series.values + np.array(zero)) * (turn / (2.0 * np.pi)), "1")


def _three(log: Log, name: str, unit: str) -> LogSeries:
    series = log.vector(name)
    if series.values.shape[1] != 3:
        raise LogRefused(f"{log.path}: {name} has {series.values.shape[1]} components, expected 3, one per joint")
    return _in_unit(log, name, series, unit)


def _in_unit(log: Log, name: str, series: LogSeries, unit: str) -> LogSeries:
    if series.unit != unit:
        got, wanted = known_unit(series.unit), known_unit(unit)
        hint = weight_hint(got.dimension, wanted.dimension) if got and wanted else ""
        raise LogRefused(
            f"{log.path}: {name} is in '{series.unit}', expected '{unit}'{hint or ';'} say so with "
            f"--map {name}=COLUMN[UNIT]"
        )
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
        LogRefused: the first sample fits no pose of the robot, so there is nothing to hold.
    """
    component = Estimator(belief, gravity_compensation)
    rows, status = play(component, log.t, np.full(len(log.t), log.period), np.hstack([log.count_m, log.count_l]))
    if status:
        at = [np.degrees(angle(log.count_l[0, i], belief.joint_counts, belief.joint_zero[i])) for i in range(3)]
        raise LogRefused(
            f"{log.path}: the first joint angles ({at[0]:.1f}, {at[1]:.1f}, {at[2]:.1f}) deg fit no pose of the robot; "
            "are their signs, units and zeros those of the experiment?"
        )
    return columns(component, rows)


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
