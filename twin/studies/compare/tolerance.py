"""Tolerances of a comparison, in value and in time: rules, tubes, time alignment, common signals.

A rule of `--tol` is SIGNAL = "VALUE UNIT", "SHARE %" or either with "@ TIME"; "@ TIME" alone keeps the value. A share
is relative to the reference's range. SIGNAL may contain * and ?; a vector's name means all of its components. Rules
come from a TOML file, from texts on the command line, or both; the last rule that matches a signal and sets a number
wins:

    "*" = "2 % @ 4 ms"
    "controller.F_z" = "0.05 N"
    "plant.p_B" = "0.1 mm @ 10 ms"

    --tol 2%@4ms  --tol controller.F_z=0.05N  --tol 'plant.*=0.1mm@10ms'

The tolerance tube around a reference accepts values that are a little early, late, high or low. At time t the tube
extends from the smallest value of the reference in [t - dt, t + dt], less a tolerance, to the largest, plus the
tolerance; without the tolerance it is the reference's reach. The reference is the polygon through its samples, so the
ends of the window count with their interpolated values, and a copy of the reference shifted by at most dt is inside for
any slope.
"""

import math
import re
from collections.abc import Iterable, Sequence
from dataclasses import dataclass
from fnmatch import fnmatchcase
from pathlib import Path
from typing import Literal, NamedTuple, cast, get_args

import numpy as np
from numpy.typing import NDArray

from twin.kernel.errors import InputRefused, nearest
from twin.kernel.files import read_toml
from twin.kernel.recording.logs.log import Log, LogSeries
from twin.kernel.units import Dimension, Unit, known_unit, weight_hint
from twin.studies.result import join_names

TIME_DIMENSION = Dimension(s=1)
_RULE_PATTERN = re.compile(r"\s*(?:([0-9.eE+-]+)\s*([^@]*?))?\s*(?:@\s*([0-9.eE+-]+)\s*(\S+))?\s*")
Curve = NDArray[np.float64]
Kind = Literal["none", "start", "event", "fit"]
MIN_OVERLAP = 0.5
"""Minimum share of the shorter series that overlaps after a fitted shift; less would fit the ends to each other."""
MAX_SHIFTS = 500
"""Maximum number of shifts tried in either direction before the best is refined."""


@dataclass(frozen=True)
class Rule:
    """Tolerance rule of a comparison, for the signals that match a pattern.

    Attributes:
        pattern: name with * and ?; a vector's name without index matches its components.
        value: half width (SI); None if the rule leaves it unchanged.
        dimension: dimension of the value; None if the value is a share of the range.
        dt: half width in time (s); None if the rule leaves it unchanged.
    """

    pattern: str
    value: float | None = None
    dimension: Dimension | None = None
    dt: float | None = None


DEFAULT_RULE = Rule("*", 0.02, None, 0.004)
"""2 % of the range, and two periods of the robot's controller (2 ms)."""


@dataclass(frozen=True)
class Allowance:
    """Tolerance of one compared signal: half widths of its tube in value (SI) and in time (s)."""

    value: float
    dt: float


def matches(pattern: str, signal: str) -> bool:
    """Whether a signal, or the vector that contains it, matches a pattern with * and ?."""
    # brackets are indices, not character classes
    literal = pattern.replace("[", "[[]")
    return fnmatchcase(signal, literal) or fnmatchcase(signal.partition("[")[0], literal)


def rules(entries: Sequence[str | Path]) -> tuple[Rule, ...]:
    """Parse tolerance rules, given as texts or TOML files, in their order."""
    found: list[Rule] = []
    mistakes: list[str] = []
    for entry in entries:
        if isinstance(entry, Path) or entry.endswith(".toml"):
            path = Path(entry)
            for pattern, text in _table(path, mistakes).items():
                _add(found, mistakes, str(path), pattern, text)
        else:
            pattern, equals, text = entry.rpartition("=")
            _add(found, mistakes, "--tol", pattern.strip() if equals else "*", text)
    if mistakes:
        raise InputRefused("\n".join(mistakes))
    return tuple(found)


def allowance(signal: str, unit: Unit, span: float, magnitude: float, given: Iterable[Rule]) -> Allowance:
    """Return the tolerance of one signal from the default rule and the given rules; the last matching rule wins.

    Args:
        span: range of the reference, for a component of a vector the range of the widest component (SI).
        magnitude: largest absolute value of the reference (SI); a share of the range also allows 1e-9 of it, so that
            numbers written with ten digits compare equal.
    """
    value, dt = 0.0, 0.0
    for rule in (DEFAULT_RULE, *given):
        if not matches(rule.pattern, signal):
            continue
        if rule.value is not None and rule.dimension is None:
            value = rule.value * span + 1e-9 * magnitude
        elif rule.value is not None and rule.dimension == unit.dimension:
            value = rule.value
        elif rule.value is not None and not set("*?") & set(rule.pattern):
            got = rule.dimension or Dimension()
            raise InputRefused(
                f"tolerance of {rule.pattern} is in {Unit(got).si}, but it is in {unit.si}"
                f"{weight_hint(got, unit.dimension)}"
            )
        dt = dt if rule.dt is None else rule.dt
    return Allowance(value, dt)


def _table(path: Path, mistakes: list[str]) -> dict[str, object]:
    """Return the rules `"controller.F_z" = TEXT` of a TOML file, with the tables of unquoted dots flattened."""
    try:
        content = read_toml(path)
    except InputRefused as problem:
        mistakes.append(f"--tol {problem}")
        return {}
    flat: dict[str, object] = {}

    def gather(prefix: str, table: dict) -> None:
        for key, value in table.items():
            if isinstance(value, dict) and value:
                gather(f"{prefix}{key}.", value)
            else:
                flat[f"{prefix}{key}"] = value

    gather("", content)
    return flat


def _add(found: list[Rule], mistakes: list[str], where: str, pattern: str, text: object) -> None:
    option = f"{where}: {pattern} = {text!r}" if where != "--tol" else f"--tol {pattern}={text}"
    match = _RULE_PATTERN.fullmatch(text) if isinstance(text, str) and text.strip() else None
    try:
        numbers = [float(part) if part is not None else None for part in (match[1], match[3])] if match else []
    except ValueError:
        numbers = []
    if not match or not pattern or not numbers or any(n is not None and not 0.0 <= n < math.inf for n in numbers):
        mistakes.append(f"{option}: expected VALUE UNIT, SHARE % or @ TIME, such as 0.05 N @ 4 ms")
        return
    value, dt = numbers
    unit, stamp = match[2] or "", match[4] or "s"
    time_unit = known_unit(stamp)
    if time_unit is None or time_unit.dimension != TIME_DIMENSION:
        mistakes.append(f"{option}: time in '{stamp}'; expected s, ms or us")
        return
    dt = None if dt is None else time_unit.in_si(dt)
    if value is None or unit == "%":
        found.append(Rule(pattern, None if value is None else value / 100.0, None, dt))
        return
    value_unit = known_unit(unit or "1")
    if value_unit is None:
        mistakes.append(f"{option}: unknown unit '{unit}'; expected one such as N, mm, deg, rad/s or %")
        return
    found.append(Rule(pattern, value_unit.in_si(value), value_unit.dimension, dt))


class Tube(NamedTuple):
    """Tolerance tube: lower and upper bound of a signal at the compared times, (n,)."""

    lower: Curve
    upper: Curve

    def widen(self, tolerance: float) -> "Tube":
        return Tube(self.lower - tolerance, self.upper + tolerance)

    def excess(self, values: Curve) -> Curve:
        """Return the distance of values (n,) from the tube: > 0 above, < 0 below, 0 inside, infinite for NaN."""
        above, below = np.maximum(values - self.upper, 0.0), np.minimum(values - self.lower, 0.0)
        return np.where(np.isfinite(above + below), above + below, np.inf)


def reach(t: Curve, values: Curve, at: Curve, dt: float) -> Tube:
    """Compute the smallest and largest value of a reference curve within `dt` of each time in `at`.

    Args:
        t, values: samples of the reference, (n,); t strictly ascending (s).
        at: times of comparison, (m,), ascending (s), within [t[0], t[-1]].
        dt: half width in time (s).
    """
    if dt == 0.0:
        middle = np.interp(at, t, values)
        return Tube(middle, middle)
    # the reference has no values beyond its ends: cut the window there
    left, right = np.maximum(at - dt, t[0]), np.minimum(at + dt, t[-1])
    ends = np.interp(np.stack([left, right]), t, values)
    first, last = np.searchsorted(t, left, side="left"), np.searchsorted(t, right, side="right")
    lower = np.minimum(ends.min(axis=0), _least(values, first, last))
    upper = np.maximum(ends.max(axis=0), -_least(-values, first, last))
    return Tube(lower, upper)


def _least(values: Curve, first: NDArray[np.intp], last: NDArray[np.intp]) -> Curve:
    """Compute the minimum of `values` in many index windows, infinity for an empty window.

    Uses a sparse table: level k has the minima of all windows of 2^k samples, and two of them cover any window (Bender
    and Farach-Colton, The LCA problem revisited, 2000, section 3).
    """
    lengths = last - first
    least = np.full(len(first), np.inf)
    level, width = values, 1
    while width <= lengths.max(initial=0):
        chosen = (lengths >= width) & (lengths < 2 * width)
        least[chosen] = np.minimum(level[first[chosen]], level[last[chosen] - width])
        level = np.minimum(level[:-width], level[width:]) if len(level) > width else level
        width *= 2
    return least


class Alignment(NamedTuple):
    """Method that aligns the times of two logs.

    Attributes:
        kind: `none`: both count from the same instant. `start`: the first samples are the same instant. `event`:
            `signal` crosses the middle of the first log's range for the first time. `fit`: the rms difference of
            `signal` is least.
        signal: signal for event and fit.
        max_shift: limit for fit (s).
    """

    kind: Kind = "none"
    signal: str = ""
    max_shift: float = 1.0


class TimeShift(NamedTuple):
    """Time to add to the second log (s) for alignment, and a note if the result is doubtful."""

    seconds: float = 0.0
    note: str = ""


def alignment(kind: str, signal: str = "", max_shift: float = 1.0) -> Alignment:
    """Convert the options --align, --by and --max-shift to a method of time alignment."""
    if kind not in get_args(Kind):
        raise InputRefused(f"--align {kind}: expected one of {', '.join(get_args(Kind))}")
    if kind in ("event", "fit") and not signal:
        raise InputRefused(f"--align {kind}: expected a signal; add --by SIGNAL")
    if not 0.0 < max_shift < np.inf:
        raise InputRefused(f"--max-shift {max_shift:g}: expected a time > 0 s")
    return Alignment(cast(Kind, kind), signal, max_shift)


def time_shift(a: Log, b: Log, how: Alignment) -> TimeShift:
    if how.kind == "none":
        return TimeShift()
    if how.kind == "start":
        first = [min(series.t[0] for series in log.series.values()) for log in (a, b)]
        return TimeShift(float(first[0] - first[1]))
    ours, theirs = a[how.signal], b[how.signal]
    if np.ptp(ours.values) == 0.0 or np.ptp(theirs.values) == 0.0:
        raise InputRefused(f"--by {how.signal}: is constant and cannot be aligned")
    if how.kind == "event":
        return _event_shift(a, b, how.signal)
    return _best_shift(ours, theirs, how.max_shift)


def _event_shift(a: Log, b: Log, signal: str) -> TimeShift:
    level = 0.5 * float(a[signal].values.min() + a[signal].values.max())
    times = []
    for log in (a, b):
        t, above = log[signal].t, log[signal].values - level
        crossings = np.flatnonzero((above[1:] >= 0.0) != (above[:-1] >= 0.0))
        if not len(crossings):
            raise InputRefused(f"{log.path}: {signal} never crosses {level:.4g}, the middle of the first's range")
        k = crossings[0]
        times.append(float(t[k] + (t[k + 1] - t[k]) * above[k] / (above[k] - above[k + 1])))
    return TimeShift(times[0] - times[1])


def _best_shift(ours: LogSeries, theirs: LogSeries, limit: float) -> TimeShift:
    """Find the shift of least rms difference on a grid, as the rms may have several minima, then refine."""
    # imported here, because scipy loads slowly
    from scipy.optimize import minimize_scalar

    least = MIN_OVERLAP * min(np.ptp(ours.t), np.ptp(theirs.t))

    def rms(seconds: float) -> float:
        start, end = max(ours.t[0], theirs.t[0] + seconds), min(ours.t[-1], theirs.t[-1] + seconds)
        if end - start < least:
            return np.inf
        inside = (ours.t >= start) & (ours.t <= end)
        error = np.interp(ours.t[inside], theirs.t + seconds, theirs.values) - ours.values[inside]
        return float(np.sqrt(np.mean(error**2))) if len(error) else np.inf

    step = max(limit / MAX_SHIFTS, min(limit, min(ours.sampling.period, theirs.sampling.period)))
    count = int(np.ceil(limit / step))
    grid = np.linspace(-limit, limit, 2 * count + 1)
    costs = np.array([rms(seconds) for seconds in grid])
    if not np.isfinite(costs).any():
        raise InputRefused(
            f"--align fit: within {limit:g} s the logs overlap by less than half of the shorter; widen --max-shift, or "
            "try --align start"
        )
    # the smallest of equally good shifts
    best = min(range(len(grid)), key=lambda k: (costs[k], abs(grid[k])))
    low, high = grid[max(best - 1, 0)], grid[min(best + 1, len(grid) - 1)]
    refined = minimize_scalar(rms, bounds=(low, high), method="bounded", options={"xatol": 1e-3 * step})
    found = float(refined.x) if refined.fun < costs[best] else float(grid[best])
    note = f"the best shift is at the end of --max-shift {limit:g}; widen it" if best in (0, len(grid) - 1) else ""
    return TimeShift(found, note)


def common_units(a: Log, b: Log, signals: Sequence[str], given: Sequence[Rule]) -> dict[str, Unit]:
    """Return the signals of both logs to compare (patterns; empty for all) with units; each rule must match one."""
    common = [name for name in a.series if name in b.series]
    if not common:
        raise InputRefused(_nothing_in_common(a, b))
    mistakes = [
        f"--signal {pattern}: no such signal is in both logs; {_nearest(pattern, common)}"
        for pattern in signals
        if not any(matches(pattern, name) for name in common)
    ]
    there = [*a.series, *b.series]
    mistakes += [
        f"tolerance of {rule.pattern}: no such signal; {_nearest(rule.pattern, common)}"
        for rule in given
        if not any(matches(rule.pattern, name) for name in there)
    ]
    names = [name for name in common if not signals or any(matches(pattern, name) for pattern in signals)]
    units = {name: _unit(a[name]) for name in names}
    for name in names:
        if _unit(b[name]).dimension != units[name].dimension:
            bare = [log.path for log in (a, b) if log[name].unit == "1"]
            hint = f"{bare[0]} states no unit; --map {name}=COLUMN[UNIT]" if bare else "correct it with --map"
            hint += weight_hint(_unit(b[name]).dimension, units[name].dimension)
            mistakes.append(f"{name} is in {a[name].unit} in {a.path} but in {b[name].unit} in {b.path}; {hint}")
    if mistakes:
        raise InputRefused("\n".join(mistakes))
    return units


def signal_ranges(a: Log) -> dict[str, float]:
    """Return the range of each signal, for a component the vector's widest, since noise alone has no scale."""
    widest: dict[str, float] = {}
    for name, series in a.series.items():
        finite = series.values[np.isfinite(series.values)]
        vector = name.partition("[")[0]
        widest[vector] = max(widest.get(vector, 0.0), float(np.ptp(finite)) if len(finite) else 0.0)
    return widest


def no_overlap(a: Log, b: Log, name: str, seconds: float) -> str:
    ours, theirs = a[name].t, b[name].t + seconds
    ends = f"{a.path} has {ours[0]:.6g} .. {ours[-1]:.6g} s, {b.path} has {theirs[0]:.6g} .. {theirs[-1]:.6g} s"
    return f"no instants in common: {ends}; align them with --align start, or event or fit with --by SIGNAL"


def _nearest(pattern: str, names: Sequence[str]) -> str:
    known = dict.fromkeys(name.partition("[")[0] for name in names)
    return nearest(pattern.partition("[")[0], known, "there are {}", 3)


def _nothing_in_common(a: Log, b: Log) -> str:
    """Return the error message for two logs without common signal names, with suggested pairs of names."""
    for log, other in ((b, a), (a, b)):
        for name in log.series:
            meant = [n for n in other.series if re.split(r"[./]", n)[-1] == name]
            if meant:
                choice = f"choose with --map {meant[0]}=COLUMN[UNIT]"
                return f"{log.path}: '{name}' could be {' or '.join(meant)}; {choice}"
    there = "; ".join(f"{log.path} has {some_signals(log.series, 6)}" for log in (a, b))
    return f"no signal in common: {there}; name them with --map NAME=COLUMN[UNIT]"


def some_signals(names: Iterable[str], most: int) -> str:
    """Join at most `most` signal names as text; elements of an array count as one."""
    return join_names(list(dict.fromkeys(name.partition("[")[0] for name in names)), most)


def _unit(series: LogSeries) -> Unit:
    return known_unit(series.unit) or Unit(Dimension())
