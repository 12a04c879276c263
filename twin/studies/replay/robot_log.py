"""What a robot recorded, as the estimator takes it: encoder counts, and a measured force if there is one."""

import re
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from twin.controller.belief import Belief
from twin.recording.logs.log import Log, LogRefused, LogSeries
from twin.units import known_unit, weight_hint

SCALE = "scale.F_z"
COUNTS = {"count_m": "theta_m", "count_l": "theta_l"}
"""The counts of the motor and joint encoders, and the angles that a log may have in their place."""
LONGEST = 1e8
"""s; three years, after which nobody replays a log."""
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
