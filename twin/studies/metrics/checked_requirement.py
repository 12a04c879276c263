"""Whether a formula can be evaluated: of signals that a run has, in units that fit together."""

from collections.abc import Mapping
from typing import NamedTuple, Protocol

from twin.errors import InputRefused, nearest
from twin.experiment.requirement import AtMost, Formula, Holds, Joined, Not, Sum, Term, Until, Within, requirement
from twin.units import known_unit


class Signal(Protocol):
    """What is known of a recorded signal before a run, as `twin.recording.layout.Field` has it."""

    @property
    def size(self) -> int: ...
    @property
    def kind(self) -> str: ...
    @property
    def unit(self) -> str: ...


def checked_requirement(text: str, signals: Mapping[str, Signal]) -> tuple[Formula, str]:
    """The formula that `text` spells, and the SI unit of its distance; "1" where it compares nothing.

    Args:
        signals: `topic.field` of those that a run has.

    Raises:
        InputRefused: it spells none, names a signal that is not among these, or mixes units.
    """
    try:
        formula = requirement(text)
        units = _units(formula, signals)
    except ValueError as problem:
        raise InputRefused(f'"{text}": {problem}') from None
    if len(units) > 1:
        raise InputRefused(
            f'"{text}": compares in {" and in ".join(sorted(units))}, and a distance has one unit; make a requirement '
            "for each"
        )
    return formula, units.pop() if units else "1"


def _units(formula: Formula, signals: Mapping[str, Signal]) -> set[str]:
    """SI units of the comparisons in `formula`.

    Raises:
        ValueError: it cannot be evaluated.
    """
    match formula:
        case AtMost(smaller, larger):
            sides = [_measure(side, signals) for side in (smaller, larger)]
            if not any(isinstance(term.what, str | tuple) for term in (*smaller, *larger)):
                raise ValueError("a comparison of numbers; expected a signal on one side")
            if sides[0].size > 1 or sides[1].size > 1:
                raise ValueError("a comparison of vectors; expected one component, x[2], or the size, |x|")
            return {_common(*sides)}
        case Holds(signal):
            if _known(signal, signals).kind != "bool":
                raise ValueError(f"{signal} is not true or false; expected a comparison")
            return set()
        case Not(of) | Within(_, of):
            return _units(of, signals)
        case Joined(_, left, right) | Until(left, right):
            return _units(left, signals) | _units(right, signals)


class _Measure(NamedTuple):
    size: int
    unit: str


def _common(one: _Measure, other: _Measure) -> str:
    if one.unit != other.unit:
        raise ValueError(f"{one.unit} beside {other.unit}; expected the same unit, and of every number its own")
    return one.unit


def _measure(terms: Sum, signals: Mapping[str, Signal]) -> _Measure:
    found = [_of_term(term, signals) for term in terms]
    for one in found[1:]:
        _common(found[0], one)
        if one.size != found[0].size:
            raise ValueError(f"a sum of {found[0].size} and {one.size} components; expected as many")
    return found[0]


def _of_term(term: Term, signals: Mapping[str, Signal]) -> _Measure:
    if isinstance(term.what, tuple):
        return _measure(term.what, signals)._replace(size=1)
    if not isinstance(term.what, str):
        assert term.unit is not None
        return _Measure(1, term.unit.si)
    signal = _known(term.what, signals)
    if term.index is not None and (signal.size == 1 or term.index >= signal.size):
        wanted = f"[0] to [{signal.size - 1}]" if signal.size > 1 else "no index"
        raise ValueError(f"{term.what}[{term.index}]: it has {signal.size} components; expected {wanted}")
    unit = known_unit(signal.unit)
    return _Measure(signal.size if term.index is None else 1, unit.si if unit else signal.unit)


def _known(name: str, signals: Mapping[str, Signal]) -> Signal:
    if name not in signals:
        raise ValueError(f"no such signal as {name}; {nearest(name, signals, 'there are {}', 3)}")
    return signals[name]
