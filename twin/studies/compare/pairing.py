"""Which signals of two logs are the same quantity, and the sentences where none are."""

import re
from collections.abc import Sequence

import numpy as np

from twin.errors import nearest
from twin.recording.logs.log import Log, LogSeries
from twin.studies.compare.tolerance import ComparisonRefused, Rule, matches
from twin.units import Dimension, Unit, known_unit, weight_hint


def paired(a: Log, b: Log, signals: Sequence[str], given: Sequence[Rule]) -> dict[str, Unit]:
    """Names of the signals to compare, with their units.

    Args:
        a, b: the logs.
        signals: patterns; empty: all that both have.
        given: rules of tolerance, each of which must be about some signal of the logs.

    Raises:
        ComparisonRefused: no signal in common, units of different dimensions, a pattern that fits no signal.
    """
    common = [name for name in a.series if name in b.series]
    if not common:
        raise ComparisonRefused(_nothing_in_common(a, b))
    mistakes = [
        f"--signal {pattern}: no such signal is in both logs; {_nearest(pattern, common)}"
        for pattern in signals
        if not any(matches(pattern, name) for name in common)
    ]
    there = [*a.series, *b.series]
    mistakes += [
        f"tolerance of {rule.pattern}: no such signal; {_nearest(rule.pattern, common)}"
        for rule in given
        if not any(rule.fits(name) for name in there)
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
        raise ComparisonRefused("\n".join(mistakes))
    return units


def spans(a: Log) -> dict[str, float]:
    """Range of each signal; of a vector that of its widest component, as one that is only noise has no scale."""
    widest: dict[str, float] = {}
    for name, series in a.series.items():
        finite = series.values[np.isfinite(series.values)]
        vector = name.partition("[")[0]
        widest[vector] = max(widest.get(vector, 0.0), float(np.ptp(finite)) if len(finite) else 0.0)
    return widest


def no_overlap(a: Log, b: Log, name: str, seconds: float) -> str:
    """The sentence for logs whose times, `seconds` added to those of `b`, have nothing in common."""
    ours, theirs = a[name].t, b[name].t + seconds
    ends = f"{a.path} has {ours[0]:.6g} .. {ours[-1]:.6g} s, {b.path} has {theirs[0]:.6g} .. {theirs[-1]:.6g} s"
    return f"no instants in common: {ends}; align them with --align start, or event or fit with --by SIGNAL"


def _nearest(pattern: str, names: Sequence[str]) -> str:
    known = dict.fromkeys(name.partition("[")[0] for name in names)
    return nearest(pattern.partition("[")[0], known, "there are {}", 3)


def _nothing_in_common(a: Log, b: Log) -> str:
    """The sentence that leads from `F_z` of one log to `controller.F_z` of the other."""
    for log, other in ((b, a), (a, b)):
        for name in log.series:
            meant = [n for n in other.series if re.split(r"[./]", n)[-1] == name]
            if meant:
                choice = f"say which with --map {meant[0]}=COLUMN[UNIT]"
                return f"{log.path}: '{name}' could be {' or '.join(meant)}; {choice}"
    there = f"{a.path} has {_some(a)}; {b.path} has {_some(b)}"
    return f"no signal in common: {there}; name them with --map NAME=COLUMN[UNIT]"


def _some(log: Log) -> str:
    names = list(dict.fromkeys(name.partition("[")[0] for name in log.series))
    return ", ".join(names[:6]) + (f" and {len(names) - 6} more" if len(names) > 6 else "")


def _unit(series: LogSeries) -> Unit:
    return known_unit(series.unit) or Unit(Dimension())
