"""Samples of a robot: encoder counts, commands, measured force and torques, from a log or a run of the twin."""

import re
from collections.abc import Iterable, Mapping
from dataclasses import dataclass, field, replace
from functools import cached_property
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from twin.kernel.cosim.port import port_slices, width
from twin.kernel.errors import InputRefused
from twin.kernel.recording.logs.column_map import refuse_unit
from twin.kernel.recording.logs.log import (
    Log,
    LogError,
    LogSeries,
    MappedColumn,
    Sampling,
    join_rows,
    refuse_invalid,
    sampling,
)
from twin.robot.controller.controller import Belief
from twin.robot.run.view import RunView, sample_and_hold
from twin.studies.replay.plausible import ANGLE_OF_COUNT, FORCE_SIGNAL, count_conversion
from twin.studies.replay.sample_columns import ENCODERS, F_Z, INPUTS, OMEGA_REF

MAX_LOG_TIME, MAX_SAMPLED_TIME = 4e9, 1e8
"""Maximum time of a log (s), for a clock that steps from 0 to the time since 1970; maximum time with samples, three
years. Longer ones are in another unit."""
MAX_LISTED_NAMES = 12


@dataclass(frozen=True)
class RobotSamples:
    """Samples of a robot in order of time: encoder counts, commands, force and torques.

    Attributes:
        t: sampling times (n,), s, ascending, by the robot's clock.
        u: signals by `INPUTS` (n, 13), SI; NaN without news since the previous sample. Counts computed from
            angles are not integers. A measured force is at the first sample at or after its own time.
        force: measured pressing force at its own times (N); None if unknown.
        path: file of the log; empty for a live robot and a run in memory.
        notes: problems of the log, one sentence each.
        columns: column of each signal, see `Log`.
    """

    t: NDArray[np.float64]
    u: NDArray[np.float64]
    force: LogSeries | None = None
    path: Path = Path()
    notes: tuple[str, ...] = ()
    columns: Mapping[str, MappedColumn] = field(default_factory=dict)

    def rows(self, chosen: slice | NDArray) -> "RobotSamples":
        """Select samples of the robot by a slice, indices (k,) or a mask (n,)."""
        return replace(self, t=self.t[chosen], u=self.u[chosen])

    def held_commands(self, omega_ref: NDArray[np.float64]) -> "RobotSamples":
        """Hold each command until the next one; omega_ref: commands (3,) before the first, rad/s."""
        commanded = np.vstack([omega_ref, self.u[:, OMEGA_REF]])
        newest = np.maximum.accumulate(np.where(np.isnan(commanded), 0, np.arange(len(commanded))[:, None]), axis=0)
        u = self.u.copy()
        u[:, OMEGA_REF] = np.take_along_axis(commanded, newest, axis=0)[1:]
        return replace(self, u=u)

    def only(self, name: str) -> NDArray[np.float64]:
        """Columns of one input signal, `name`, in the samples (n, size), a view."""
        return self.u[:, port_slices(INPUTS)[name]]

    @property
    def counts(self) -> NDArray[np.float64]:
        """Encoder counts of motors and joints in the samples (n, 6), a view."""
        return self.u[:, ENCODERS]

    @property
    def periods(self) -> NDArray[np.float64]:
        """Time between each sample and the previous one (n,), s; infinite for the first sample."""
        return np.diff(self.t, prepend=-np.inf)

    @cached_property
    def sampling(self) -> Sampling:
        """Sampling of the robot's data: median period, gaps and missing samples; n >= 2."""
        return sampling(self.t)


def samples_of(run: RunView) -> RobotSamples:
    """Extract samples from a run as the computer receives them, faults included; a force only at its own times."""
    has = run.fields()
    if "encoder.count_m" not in has or "encoder.count_l" not in has:
        raise InputRefused("no encoder.count_m and encoder.count_l: a shadow needs the counts of all six encoders")
    t = run.time("encoder")
    u = np.full((len(t), width(INPUTS)), np.nan)
    taken = RobotSamples(t, u)
    for name in ANGLE_OF_COUNT:
        taken.only(name)[:] = sample_and_hold(run, _received(name, has), t)
    if "controller.omega_ref" in has:
        taken.only("omega_ref")[:] = sample_and_hold(run, "controller.omega_ref", t)
    for leg in range(3):
        key = f"drive/{leg + 1}.tau_motor"
        if key in has:
            taken.only("tau_motor")[:, leg] = sample_and_hold(run, key, t)
    if FORCE_SIGNAL in has:
        hold_until_sampled(taken, F_Z.start, run.time("scale"), run[FORCE_SIGNAL])
    return taken


def robot_samples(log: Log, belief: Belief) -> RobotSamples:
    """Extract a robot's samples, i.e. encoders and measured force, from a log.

    Encoders: `encoder.count_m[0..2]`, `encoder.count_l[0..2]` (1), or `estimator.theta_m`, `estimator.theta_l` (rad)
    instead. In a recording with faulty encoders, the received counts are used: the counts of the last /fault/n that has
    any. Measured force: `scale.F_z` (N), pressing positive. Encoders are joined to rows by `join_rows`; times without
    all six are left out.
    """
    sides = [_counts_in(log, name, belief) for name in ANGLE_OF_COUNT]
    counts = join_rows(sides)
    if 2 * len(counts.t) < min(len(one.t) for one in sides) or len(counts.t) < 2:
        raise LogError(
            f"{log.path}: motor and joint encoders have different times; expected one sample of both at each, less "
            "than half a period apart"
        )
    refuse_invalid(log.path, "an encoder", len(counts.invalid), len(counts.invalid) + len(counts.t))
    lost = max(len(one.t) for one in sides) - len(counts.t)
    notes = (*log.notes, f"{lost} samples without all six encoders are left out") if lost else log.notes
    if measured := log.series.get(FORCE_SIGNAL):
        refuse_unit(f"{log.path}:", FORCE_SIGNAL, measured.unit, "N")
    if counts.t[0] < 0.0:
        raise LogError(f"{log.path}: begins at {counts.t[0]:g} s, before 0; count its time from its first sample")
    sampled = len(counts.t) * counts.sampling.period
    for what, time, most in (("ends at", counts.t[-1], MAX_LOG_TIME), ("has samples for", sampled, MAX_SAMPLED_TIME)):
        if time > most:
            raise LogError(f"{log.path}: {what} {time:g} s, expected at most {most:g} s; is its unit right?")
    # the estimator holds its last value over missing counts, but needs a first one
    there = np.all(np.isfinite(counts.values), axis=1)
    if np.sum(there) < 2:
        raise LogError(f"{log.path}: fewer than two samples have all six counts")
    first = int(np.argmax(there))
    t, u = counts.t[first:], np.full((len(counts.t) - first, width(INPUTS)), np.nan)
    u[:, ENCODERS] = counts.values[first:]
    samples = RobotSamples(t, u, measured, log.path, notes, log.columns)
    if measured is not None:
        hold_until_sampled(samples, F_Z.start, measured.t, measured.values)
    return samples


def hold_until_sampled(samples: RobotSamples, column: int, t: NDArray[np.float64], values: NDArray[np.float64]) -> None:
    """Write `values` (m,) of times `t` (m,), s, into a column, at the next sample, the newest of several."""
    at = np.searchsorted(samples.t, t)
    there = at < len(samples.t)
    samples.u[at[there], column] = values[there]


def _received(name: str, keys: Iterable[str]) -> str:
    """Return the name of the received counts in a recording: those of the last encoder fault, else of the encoder."""
    faults = [int(m[1]) for key in keys if (m := re.fullmatch(rf"fault/(\d+)\.{name}(\[0\])?", key))]
    return f"fault/{max(faults)}.{name}" if faults else f"encoder.{name}"


def _counts_in(log: Log, name: str, belief: Belief) -> LogSeries:
    """Read the counts (n, 3) of the motor or the joint encoders from a log, possibly converted from angles."""
    angle = f"estimator.{ANGLE_OF_COUNT[name]}"
    counts = _received(name, log.series)
    there = {name.rpartition("[")[0] for name in (*log.series, *log.left_out)}
    if counts in there:
        return _joint_series(log, counts, "1")
    if angle not in there:
        has = list(log.series)
        raise LogError(
            f"{log.path}: neither {counts}[0..2] nor {angle}[0..2] is there; it has {', '.join(has[:MAX_LISTED_NAMES])}"
            f"{' ...' if len(has) > MAX_LISTED_NAMES else ''}; choose with --map '{angle}[0]=COLUMN[deg]' and so on"
        )
    series = _joint_series(log, angle, "rad")
    # the inverse of `estimator.angle`
    zero, per_rad = count_conversion(name, belief)
    return replace(series, values=(series.values + np.array(zero)) * per_rad, unit="1")


def _joint_series(log: Log, name: str, unit: str) -> LogSeries:
    series = log.vector(name)
    if series.values.shape[1] != 3:
        raise LogError(f"{log.path}: {name} has {series.values.shape[1]} components, expected 3, one per joint")
    refuse_unit(f"{log.path}:", name, series.unit, unit)
    return series
