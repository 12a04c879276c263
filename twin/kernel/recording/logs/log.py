"""Log in memory: time series in SI units by signal, and their missing samples."""

import re
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from functools import cached_property
from pathlib import Path
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from twin.kernel.errors import InputRefused, nearest

MAX_QUANTITY = 1e100
"""Maximum value of a quantity, whose square is still finite."""
GAP_RATIO = 1.5
"""Minimum length of a gap in median intervals: at least one sample is missing."""
MIN_REGULAR_SHARE = 0.6
"""Minimum share of intervals within half of the median for regular sampling. A clock that loses three samples in ten at
random keeps 0.7; random points have 0.35 (intervals of a Poisson process)."""
MAX_INVALID_SHARE = 0.05
"""Maximum share of NaN, null or infinite samples of a needed signal."""


class LogError(InputRefused):
    """Error for an unusable log or column map; the message has the place, the value found, and the expected one."""


class NoNumbers(LogError):
    """Error for a signal with fewer than two numbers in the log."""


@dataclass(frozen=True)
class MappedColumn:
    """Column of a foreign file that a signal is read from: value in SI = sign (1 or -1) * value in `unit`.

    `unit` is as the user wrote it; empty if in the column's name. `text` is all as one text, possibly a column's name.
    """

    name: str
    unit: str = ""
    sign: int = 1
    text: str = field(default="", compare=False)


class Sampling(NamedTuple):
    """Sampling of a time series: median interval (s), regularity, start and end (s) of intervals with missing samples.

    `gaps` (k, 2) is empty if the intervals are not regular.
    """

    period: float
    regular: bool
    gaps: NDArray[np.float64]

    @property
    def missing(self) -> int:
        """Number of samples missing in all gaps."""
        return int(np.sum(np.rint(np.diff(self.gaps, axis=1) / self.period) - 1)) if len(self.gaps) else 0

    @property
    def note(self) -> str:
        """Describe the missing samples in half a sentence; empty for a complete series."""
        if not len(self.gaps):
            return ""
        lengths = self.gaps[:, 1] - self.gaps[:, 0]
        longest = int(np.argmax(lengths))
        lost = f"{self.missing} sample{'s' if self.missing > 1 else ''} missing"
        if len(self.gaps) == 1:
            return f"{lost} in a gap of {lengths[0]:.4g} s at {self.gaps[0, 0]:.6g} s"
        where = f"the longest {lengths[longest]:.4g} s at {self.gaps[longest, 0]:.6g} s"
        return f"{lost} in {len(self.gaps)} gaps, {where}"


def sampling(t: NDArray[np.float64]) -> Sampling:
    """Determine period, regularity and gaps of strictly ascending times t (n,), n >= 2, in s."""
    intervals = np.diff(t)
    period = float(np.median(intervals))
    regular = bool(np.mean(np.abs(intervals - period) <= 0.5 * period) >= MIN_REGULAR_SHARE)
    # tolerate round-off of large stamps
    wide = np.flatnonzero(intervals > GAP_RATIO * period * (1.0 + 1e-6)) if regular else np.empty(0, dtype=int)
    return Sampling(period, regular, np.stack([t[wide], t[wide + 1]], axis=1))


def in_gap(t: NDArray[np.float64], gaps: NDArray[np.float64]) -> NDArray[np.bool_]:
    """Check for each of the times t (n,) whether it is strictly inside one of the ascending `gaps` (k, 2)."""
    if not len(gaps):
        return np.zeros(len(t), dtype=bool)
    last = np.searchsorted(gaps[:, 0], t, side="left") - 1
    return (last >= 0) & (t < gaps[np.maximum(last, 0), 1])


@dataclass(frozen=True)
class LogSeries:
    """Time series of a quantity at times (s) strictly ascending: values (n,), or (n, k) from `Log.vector`.

    Units are SI as in recordings: `N`, `rad/s`, `1`. `invalid` has the ascending times of NaN, null or infinity.
    """

    t: NDArray[np.float64]
    values: NDArray[np.float64]
    unit: str
    invalid: NDArray[np.float64] = field(default_factory=lambda: np.empty(0))

    @cached_property
    def sampling(self) -> Sampling:
        return sampling(self.t)

    def clip(self, start: float, end: float) -> "LogSeries":
        """Return the samples of the series from `start` to `end` (s)."""
        use = (self.t >= start) & (self.t <= end)
        invalid = self.invalid[(self.invalid >= start) & (self.invalid <= end)]
        return self if np.all(use) else LogSeries(self.t[use], self.values[use], self.unit, invalid)


def refuse_invalid(path: Path | str, name: str, invalid: int, samples: int) -> None:
    """Reject a needed signal with too large a share of invalid samples."""
    if invalid > MAX_INVALID_SHARE * samples:
        raise LogError(
            f"{path}: {invalid} of {samples} samples of {name} are NaN, null or infinite, expected at most "
            f"{100 * MAX_INVALID_SHARE:g} %; repair the recorder, or choose a sound part with --from-s and --to-s"
        )


def join_rows(parts: Sequence[LogSeries]) -> LogSeries:
    """Join samples of several series to rows (n, k), at the times of the first series.

    Sources stamp related samples slightly apart: mutually nearest samples less than half a period apart form a row.
    Times without a sample of every series are left out.
    """
    t = parts[0].t
    reach = 0.5 * float(np.median(np.diff(t)))
    invalid = np.unique(np.concatenate([part.invalid for part in parts]))
    invalid = invalid[np.diff(invalid, prepend=-np.inf) > reach]
    if any(len(part.t) != len(t) or np.any(part.t != t) for part in parts):
        places = np.stack([_nearest_index(part.t, t) for part in parts], axis=1)
        apart = np.stack([np.abs(part.t[k] - t) for part, k in zip(parts, places.T, strict=True)], axis=1)
        # if one sample is nearest to two times, only the nearer time gets it
        mutual = [_nearest_index(t, part.t)[k] == np.arange(len(t)) for part, k in zip(parts, places.T, strict=True)]
        rows = np.flatnonzero(np.all(apart < reach, axis=1) & np.all(mutual, axis=0))
        values = [part.values[k[rows]] for part, k in zip(parts, places.T, strict=True)]
        t = t[rows]
    else:
        values = [part.values for part in parts]
    return LogSeries(t, np.column_stack(values), parts[0].unit, invalid)


def _nearest_index(of: NDArray[np.float64], t: NDArray[np.float64]) -> NDArray[np.intp]:
    """Find the index of the nearest of the ascending times `of` for each of `t`."""
    after = np.clip(np.searchsorted(of, t), 1, len(of) - 1)
    return after - (t - of[after - 1] <= of[after] - t)


@dataclass(frozen=True, repr=False)
class Log:
    """Log in memory with access by signal: `log["arm.force"]`, `log.vector("arm.tip")`.

    `series` are scalar, `arm.tip[2]` a component of a vector. `notes` are sentences on missing data: missing samples, a
    truncated end; `comments` are the lines of the head that start with #, without it. `left_out`: unreadable signal ->
    error message. `columns`: column of each signal, empty for a recording of twin.
    """

    path: Path
    series: dict[str, LogSeries]
    notes: tuple[str, ...] = ()
    comments: tuple[str, ...] = ()
    left_out: Mapping[str, str] = field(default_factory=dict)
    columns: Mapping[str, MappedColumn] = field(default_factory=dict)

    def __getitem__(self, name: str) -> LogSeries:
        """Return the scalar series `name` of the log; LogError, with the nearest names, if missing or unreadable."""
        if name in self.left_out:
            raise LogError(self.left_out[name])
        if name not in self.series:
            raise LogError(f"{self.path}: '{name}' is not there; {nearest(name, self.series, 'it has {}', 3)}")
        return self.series[name]

    def vector(self, name: str) -> LogSeries:
        """Return the components `name[0]`, `name[1]`, ... of a vector signal as one series of values (n, k).

        LogError: missing or unreadable components, or components that differ in unit or have no times in common.
        """
        names = [*self.series, *self.left_out]
        indices = sorted(int(m[1]) for key in names if (m := re.fullmatch(re.escape(name) + r"\[(\d+)\]", key)))
        if not indices:
            # raises the error of a missing scalar
            self[f"{name}[0]"]
        if indices != list(range(len(indices))):
            raise LogError(f"{self.path}: '{name}' has components {indices}, expected all from 0 on")
        parts = [self[f"{name}[{i}]"] for i in indices]
        rows = join_rows(parts)
        if any(part.unit != parts[0].unit for part in parts) or len(rows.t) < 2:
            raise LogError(f"{self.path}: the components of '{name}' differ in unit or in times")
        return rows
