"""Robustness of a run against a formula of signal temporal logic at tick 0 (quantitative semantics).

A comparison's distance is the larger side minus the smaller one, `not` turns it round, `and` and `always` take the
smallest, `or` and `eventually` the largest (Fainekos and Pappas 2009; Donze and Maler 2010). A window that reaches
beyond the end of the run ends there; one that begins after it holds always and never. Offline and in discrete time, in
time proportional to the run's length (Donze, Ferrere and Maler 2013).
"""

from collections.abc import Callable, Mapping
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray
from scipy.ndimage import maximum_filter1d

from twin.kernel.errors import InputRefused, nearest
from twin.kernel.recording.messages import Field
from twin.kernel.units import known_unit
from twin.robot.experiment.measure import (
    BooleanOp,
    Formula,
    Inequality,
    Negation,
    Predicate,
    Sum,
    Temporal,
    Term,
    UntilFormula,
    parse_requirement,
)
from twin.studies.metrics.response import Curve

SignalValues = Callable[[str], NDArray]
"""Values of a signal at every tick, by `topic.field`, such as `Trace.held`."""


def distance(formula: Formula, tick: float, held: SignalValues) -> float:
    """Return the distance of a run (one tick, in s, at least) from violating `formula`; negative if violated."""
    return float(_distances(formula, tick, held)[0])


def _distances(formula: Formula, tick: float, held: SignalValues) -> Curve:
    """Return the distance of a run from violating a formula, evaluated at every tick (n,)."""
    match formula:
        case Inequality(smaller, larger):
            return _value(larger, held) - _value(smaller, held)
        case Predicate(signal):
            return np.where(held(signal), np.inf, -np.inf)
        case Negation(of):
            return -_distances(of, tick, held)
        case BooleanOp(how, left, right):
            return (np.minimum if how == "and" else np.maximum)(
                _distances(left, tick, held), _distances(right, tick, held)
            )
        case Temporal(how, of, begin, end):
            sign = -1.0 if how == "always" else 1.0
            return sign * _largest(sign * _distances(of, tick, held), *_ticks(begin, end, tick))
        case UntilFormula(hold, goal, begin, end):
            first, last = _ticks(begin, end, tick)
            fulfilled, reached = _distances(hold, tick, held), _distances(goal, tick, held)
            # with hold until begin, and from there untimed; that the goal is in time is the third of them
            before = -_largest(-fulfilled, 0, first - 1)
            after = _shift(_untimed_until(fulfilled, reached), first)
            return np.minimum(np.minimum(before, after), _largest(reached, first, last))


def _ticks(begin: float, end: float | None, tick: float) -> tuple[int, int | None]:
    return round(begin / tick), None if end is None else round(end / tick)


def _largest(values: Curve, first: int, last: int | None) -> Curve:
    """Return per tick the largest value `first` to `last` ticks later, cut at the run's end; -inf if empty."""
    if last is None or last - first >= len(values):
        return _shift(np.maximum.accumulate(values[::-1])[::-1], first)
    if last < first:
        return np.full(len(values), -np.inf)
    size = last - first + 1
    # the filter's window is centred; origin makes it begin at the tick
    windows = maximum_filter1d(values, size, mode="constant", cval=-np.inf, origin=-(size // 2))
    return _shift(windows, first)


def _shift(values: Curve, ticks: int) -> Curve:
    """Shift a curve to earlier times by a number of ticks; -inf beyond the end of the run."""
    return np.concatenate([values[ticks:], np.full(min(ticks, len(values)), -np.inf)])


def _untimed_until(held: Curve, reached: Curve) -> Curve:
    """Compute the distances (n,) of `held until reached`, without a time limit."""
    found, later = np.empty(len(held)), -np.inf
    for tick in range(len(held) - 1, -1, -1):
        later = max(reached[tick], min(held[tick], later))
        found[tick] = later
    return found


def _value(terms: Sum, held: SignalValues) -> Curve:
    """Evaluate one side of a comparison at every tick: (n,), (n, k) for vector signals, or a number for constants."""
    return np.asarray(sum(term.sign * _term(term, held) for term in terms))


def _term(term: Term, held: SignalValues) -> Curve:
    if isinstance(term.value, tuple):
        inside = _value(term.value, held)
        return np.linalg.norm(inside, axis=1) if np.ndim(inside) == 2 else np.abs(inside)
    if not isinstance(term.value, str):
        return np.asarray(term.value)
    values = held(term.value).astype(float, copy=False)
    return values if term.index is None else values[:, term.index]


def checked_requirement(text: str, signals: Mapping[str, Field]) -> tuple[Formula, str]:
    """Parse the formula in `text` and check it against the recorded signals. Return it and the SI unit of its distance,
    "1" without comparisons.

    Args:
        signals: `topic.field` -> signal of a run.
    """
    try:
        formula = parse_requirement(text)
        units = _units(formula, signals)
    except ValueError as problem:
        raise InputRefused(f'"{text}": {problem}') from None
    if len(units) > 1:
        raise InputRefused(
            f'"{text}": compares in {" and in ".join(sorted(units))}, and a distance has one unit; make a requirement '
            "for each"
        )
    return formula, units.pop() if units else "1"


def _units(formula: Formula, signals: Mapping[str, Field]) -> set[str]:
    """Collect the SI units of all comparisons in `formula`; raise ValueError if it cannot be evaluated."""
    match formula:
        case Inequality(smaller, larger):
            sides = [_measure(side, signals) for side in (smaller, larger)]
            if not any(isinstance(term.value, str | tuple) for term in (*smaller, *larger)):
                raise ValueError("a comparison of numbers; expected a signal on one side")
            if sides[0].size > 1 or sides[1].size > 1:
                raise ValueError("a comparison of vectors; expected one component, x[2], or the size, |x|")
            return {_common(*sides)}
        case Predicate(signal):
            if _signal_info(signal, signals).kind != "bool":
                raise ValueError(f"{signal} is not true or false; expected a comparison")
            return set()
        case Negation(of) | Temporal(_, of):
            return _units(of, signals)
        case BooleanOp(_, left, right) | UntilFormula(left, right):
            return _units(left, signals) | _units(right, signals)


class _Measure(NamedTuple):
    size: int
    unit: str


def _common(one: _Measure, other: _Measure) -> str:
    if one.unit != other.unit:
        raise ValueError(
            f"units differ: {one.unit} and {other.unit}; give both sides the same unit, and every number its unit"
        )
    return one.unit


def _measure(terms: Sum, signals: Mapping[str, Field]) -> _Measure:
    found = [_of_term(term, signals) for term in terms]
    for one in found[1:]:
        _common(found[0], one)
        if one.size != found[0].size:
            raise ValueError(f"a sum of {found[0].size} and {one.size} components; expected as many")
    return found[0]


def _of_term(term: Term, signals: Mapping[str, Field]) -> _Measure:
    if isinstance(term.value, tuple):
        return _measure(term.value, signals)._replace(size=1)
    if not isinstance(term.value, str):
        assert term.unit is not None
        return _Measure(1, term.unit.si)
    signal = _signal_info(term.value, signals)
    if term.index is not None and (signal.size == 1 or term.index >= signal.size):
        wanted = f"[0] to [{signal.size - 1}]" if signal.size > 1 else "no index"
        raise ValueError(f"{term.value}[{term.index}]: it has {signal.size} components; expected {wanted}")
    unit = known_unit(signal.unit)
    return _Measure(signal.size if term.index is None else 1, unit.si if unit else signal.unit)


def _signal_info(name: str, signals: Mapping[str, Field]) -> Field:
    if name not in signals:
        raise ValueError(f"no such signal as {name}; {nearest(name, signals, 'there are {}', 3)}")
    return signals[name]
