"""How far a run is from violating a formula: quantitative semantics of signal temporal logic at tick 0.

A comparison's distance is the larger side minus the smaller one, `not` turns it round, `and` and `always` take the
smallest, `or` and `eventually` the largest (Fainekos and Pappas 2009; Donze and Maler 2010). A window that reaches
beyond the end of the run ends there; one that begins after it holds always and never. Offline and in discrete time,
in time proportional to the run's length (Donze, Ferrere and Maler 2013).
"""

from typing import Protocol

import numpy as np
from numpy.typing import NDArray
from scipy.ndimage import maximum_filter1d

from twin.experiment.requirement import AtMost, Formula, Holds, Joined, Not, Sum, Term, Until, Within

Curve = NDArray[np.float64]


class Run(Protocol):
    """A run as `Trace` keeps it."""

    @property
    def tick(self) -> float: ...

    def held(self, key: str, /) -> NDArray: ...


def distance(formula: Formula, run: Run) -> float:
    """Distance of `run` from violating `formula`, in the unit of its comparisons; negative: it violates it.

    Args:
        run: every tick of it, at least one.
    """
    return float(_distances(formula, run)[0])


def _distances(formula: Formula, run: Run) -> Curve:
    """At every tick, (n,)."""
    match formula:
        case AtMost(smaller, larger):
            return _value(larger, run) - _value(smaller, run)
        case Holds(signal):
            return np.where(run.held(signal), np.inf, -np.inf)
        case Not(of):
            return -_distances(of, run)
        case Joined(how, left, right):
            return (np.minimum if how == "and" else np.maximum)(_distances(left, run), _distances(right, run))
        case Within(how, of, begin, end):
            sign = -1.0 if how == "always" else 1.0
            return sign * _largest(sign * _distances(of, run), *_ticks(begin, end, run))
        case Until(hold, goal, begin, end):
            first, last = _ticks(begin, end, run)
            held, reached = _distances(hold, run), _distances(goal, run)
            # with hold until begin, and from there untimed; that the goal is in time is the third of them
            before = -_largest(-held, 0, first - 1)
            after = _shifted(_untimed(held, reached), first)
            return np.minimum(np.minimum(before, after), _largest(reached, first, last))


def _ticks(begin: float, end: float | None, run: Run) -> tuple[int, int | None]:
    return round(begin / run.tick), None if end is None else round(end / run.tick)


def _largest(values: Curve, first: int, last: int | None) -> Curve:
    """Largest of `values` from `first` to `last` ticks later on, as far as the run goes; -inf where there is none."""
    if last is None or last - first >= len(values):
        return _shifted(np.maximum.accumulate(values[::-1])[::-1], first)
    if last < first:
        return np.full(len(values), -np.inf)
    size = last - first + 1
    # the filter's window is centred; origin makes it begin at the tick
    windows = maximum_filter1d(values, size, mode="constant", cval=-np.inf, origin=-(size // 2))
    return _shifted(windows, first)


def _shifted(values: Curve, ticks: int) -> Curve:
    """`values` of so many ticks later; -inf where the run is over."""
    return np.concatenate([values[ticks:], np.full(min(ticks, len(values)), -np.inf)])


def _untimed(held: Curve, reached: Curve) -> Curve:
    """Of `held until reached`, whenever that is."""
    found, later = np.empty(len(held)), -np.inf
    for tick in range(len(held) - 1, -1, -1):
        later = max(reached[tick], min(held[tick], later))
        found[tick] = later
    return found


def _value(terms: Sum, run: Run) -> Curve:
    """(n,), or (n, k) where the signals are vectors; a number where there are none."""
    return np.asarray(sum(term.sign * _term(term, run) for term in terms))


def _term(term: Term, run: Run) -> Curve:
    if isinstance(term.what, tuple):
        inside = _value(term.what, run)
        return np.linalg.norm(inside, axis=1) if np.ndim(inside) == 2 else np.abs(inside)
    if not isinstance(term.what, str):
        return np.asarray(term.what)
    values = run.held(term.what).astype(float, copy=False)
    return values if term.index is None else values[:, term.index]
