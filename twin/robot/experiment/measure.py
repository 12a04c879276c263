"""Measures of an experiment, [[measure]]: regression measures and requirements.

A requirement is a formula of signal temporal logic (Maler and Nickovic 2004):

    always (|plant.F_ee_B| <= 18 N)
    controller.triggered implies eventually[0 s, 2 s] (controller.F_z >= 4.5 N)

Numbers carry their units; signals are recorded ones. Operators in order of increasing precedence: implies, or, and,
until, then not, always and eventually.
"""

import re
from collections.abc import Iterator
from dataclasses import dataclass
from typing import Any, Literal

from pydantic import Field, field_validator
from pydantic.config import JsonDict

from twin.kernel.settings import Settings, optional, setting
from twin.kernel.units import Dimension, Unit, known_unit
from twin.robot.experiment.mistakes import check_kind, numbered_tables

Side = Literal["always", "eventually"]
_FORMULA_WORDS = ("and", "or", "not", "implies", "always", "eventually", "until")
_TOKEN_PATTERN = re.compile(
    r"\s*(?:(?P<signal>[a-z_]+(?:/[0-9]+)?\.[A-Za-z_][A-Za-z_0-9]*(?:\[[0-9]+\])?)"
    r"|(?P<number>[0-9]+(?:\.[0-9]*)?(?:[eE][+-]?[0-9]+)?)(?P<unit>\s*(?!(?:" + "|".join(_FORMULA_WORDS) + r")\b)"
    r"[A-Za-z%\N{DEGREE SIGN}\N{MICRO SIGN}](?:[\w%^*]|/(?=\w))*)?|(?P<word>[a-z]+)|(?P<mark><=|>=|[<>()|,+\-\[\]]))"
)
MAX_FORMULA_LENGTH = 2000
"""Maximum number of characters of a formula; longer ones could only nest absurdly deep."""
SIGNAL_PATTERN = re.compile(r"-?[a-z_]+(/[0-9]+)?\.[A-Za-z_]+(\[[0-9]+\])?")
_NAME_PATTERN = re.compile(r"[a-z0-9_]+")
MEASURE_KIND: Any = Field(description="kind of measure")
_SIGNAL_SCHEMA: JsonDict = {"pattern": f"^({SIGNAL_PATTERN.pattern})$"}


@dataclass(frozen=True)
class Term:
    """A signed term of a requirement's formula: a signal, a number, or an absolute value.

    Attributes:
        sign: 1 or -1.
        value: name of a recorded signal, `topic.field`; a number in SI; or a sum between bars.
        index: component of the signal; None for all.
        unit: unit of a number; None for the unit of the signal.
    """

    sign: int
    value: "str | float | Sum"
    index: int | None = None
    unit: Unit | None = None


Sum = tuple[Term, ...]


@dataclass(frozen=True)
class Inequality:
    """An inequality `smaller` <= `larger` of a requirement's formula; strict ones have the same robustness."""

    smaller: Sum
    larger: Sum


@dataclass(frozen=True)
class Predicate:
    """A predicate of a requirement's formula: a boolean signal is true."""

    signal: str


@dataclass(frozen=True)
class Negation:
    """Negation of a requirement's formula."""

    operand: "Formula"


@dataclass(frozen=True)
class BooleanOp:
    """Conjunction or disjunction of two formulas of a requirement."""

    operator: Literal["and", "or"]
    left: "Formula"
    right: "Formula"


@dataclass(frozen=True)
class Temporal:
    """Temporal operator: `operand` holds always or once in [begin, end] (s) from now; end None: end of the run."""

    operator: Side
    operand: "Formula"
    begin: float = 0.0
    end: float | None = None


@dataclass(frozen=True)
class UntilFormula:
    """Temporal operator: `goal` holds once within the interval, and `hold` at all ticks before."""

    hold: "Formula"
    goal: "Formula"
    begin: float = 0.0
    end: float | None = None


Formula = Inequality | Predicate | Negation | BooleanOp | Temporal | UntilFormula


def parse_requirement(text: str) -> Formula:
    """Parse the text of a requirement, a formula of signal temporal logic.

    Raises:
        ValueError: the formula is invalid; the message shows the position.
    """
    if len(text) > MAX_FORMULA_LENGTH:
        raise ValueError(f"{len(text)} characters; expected at most {MAX_FORMULA_LENGTH}")
    reader = _FormulaReader(text)
    try:
        formula = reader.formula()
    except RecursionError:
        raise ValueError("nested too deeply; expected a shorter formula") from None
    if reader.token:
        raise reader.syntax_error("'and', 'or', 'implies', 'until' or the end")
    return formula


def signals_of(formula: Formula) -> Iterator[tuple[str, int | None]]:
    """Yield (name, index) of every signal that a requirement's formula contains."""
    match formula:
        case Inequality(smaller, larger):
            yield from _term_signals((*smaller, *larger))
        case Predicate(signal):
            yield signal, None
        case Negation(of) | Temporal(_, of):
            yield from signals_of(of)
        case BooleanOp(_, left, right) | UntilFormula(left, right):
            yield from signals_of(left)
            yield from signals_of(right)


def _term_signals(terms: Sum) -> Iterator[tuple[str, int | None]]:
    for term in terms:
        if isinstance(term.value, str):
            yield term.value, term.index
        elif isinstance(term.value, tuple):
            yield from _term_signals(term.value)


class _FormulaReader:
    """Recursive-descent parser of a requirement's formula; `token` is the next token, "" at the end."""

    def __init__(self, text: str):
        self._text, self._place = text, 0
        self._match: re.Match[str] | None = None
        self.token = ""
        self._advance()

    def syntax_error(self, wanted: str) -> ValueError:
        at = self._match.start() if self._match else self._place
        rest = self._text[at:].strip()
        return ValueError(f"expected {wanted}, got {rest[:30]!r}" if rest else f"expected {wanted}, got the end")

    def formula(self) -> Formula:
        left = self._chain("or")
        if self._accept("implies"):
            return BooleanOp("or", Negation(left), self.formula())
        return left

    def _chain(self, how: Literal["and", "or"]) -> Formula:
        inner = self._until_formula if how == "and" else lambda: self._chain("and")
        left = inner()
        while self._accept(how):
            left = BooleanOp(how, left, inner())
        return left

    def _until_formula(self) -> Formula:
        left = self._single()
        if not self._accept("until"):
            return left
        begin, end = self._interval()
        return UntilFormula(left, self._single(), begin, end)

    def _single(self) -> Formula:
        if self._accept("not"):
            return Negation(self._single())
        for how in ("always", "eventually"):
            if self._accept(how):
                begin, end = self._interval()
                return Temporal(how, self._single(), begin, end)
        if self._accept("("):
            inside = self.formula()
            self._expect(")")
            return inside
        left = self._sum()
        if not re.fullmatch("[<>]=?", self.token):
            if len(left) == 1 and isinstance(left[0].value, str) and left[0].index is None and left[0].sign > 0:
                return Predicate(left[0].value)
            raise self.syntax_error("'<=' or '>='")
        rising = self.token.startswith("<")
        self._advance()
        right = self._sum()
        return Inequality(left, right) if rising else Inequality(right, left)

    def _interval(self) -> tuple[float, float | None]:
        if not self._accept("["):
            return 0.0, None
        begin = self._time()
        self._expect(",")
        end = self._time()
        self._expect("]")
        if end < begin:
            raise ValueError(f"an interval from {begin:g} s to {end:g} s; expected the earlier time first")
        return begin, end

    def _time(self) -> float:
        if self._match is None or self._match["number"] is None:
            raise self.syntax_error("a time such as 2 s")
        value, unit = self._number()
        if unit.dimension != Dimension(s=1):
            raise ValueError(f"an interval in {unit.si}; expected times such as [0 s, 2 s]")
        return value

    def _sum(self) -> Sum:
        terms = [self._term(-1 if self._accept("-") else 1)]
        while self.token in ("+", "-"):
            sign = -1 if self.token == "-" else 1
            self._advance()
            terms.append(self._term(sign))
        return tuple(terms)

    def _term(self, sign: int) -> Term:
        if self._accept("|"):
            inside = self._sum()
            self._expect("|")
            return Term(sign, inside)
        if self._match is not None and self._match["number"] is not None:
            value, unit = self._number()
            return Term(sign, value, unit=unit)
        if self._match is None or self._match["signal"] is None:
            raise self.syntax_error("a signal such as plant.p_B[2], a number with its unit or a bracket")
        vector, bracket, index = self.token.partition("[")
        self._advance()
        return Term(sign, vector, int(index.removesuffix("]")) if bracket else None)

    def _number(self) -> tuple[float, Unit]:
        assert self._match is not None
        spelt = (self._match["unit"] or "1").strip()
        unit = known_unit(spelt)
        if unit is None:
            raise ValueError(f"unit {spelt!r}: no such unit; expected one such as N, mm, deg/s or Nm")
        value = unit.in_si(float(self._match["number"]))
        self._advance()
        return value, unit

    def _expect(self, mark: str) -> None:
        if not self._accept(mark):
            raise self.syntax_error(f"'{mark}'")

    def _accept(self, word: str) -> bool:
        taken = self.token == word
        if taken:
            self._advance()
        return taken

    def _advance(self) -> None:
        if not self._text[self._place :].strip():
            self._match, self.token, self._place = None, "", len(self._text)
            return
        self._match = _TOKEN_PATTERN.match(self._text, self._place)
        if self._match is None:
            raise self.syntax_error("a formula")
        self._place, self.token = self._match.end(), self._match[0].strip()
        word = self._match["word"]
        if word and word not in _FORMULA_WORDS:
            raise ValueError(
                f"unknown word {word!r}; expected a signal such as plant.p_B[2], or {', '.join(_FORMULA_WORDS)}"
            )


class Window(Settings):
    """Keys common to all [[measure]] tables: a name and a time interval; without `until_s` to the end."""

    name: str = setting(examples=["z"], help="prefix of the names of its numbers: small letters, digits, _")
    begin: float = setting("s", default=0.0, ge=0, help="beginning of its window")
    until: float | None = optional("s", gt=0, example=3.5, help="end of its window; without it, the end of the run")

    @field_validator("name")
    @classmethod
    def _short(cls, name: str) -> str:
        if not _NAME_PATTERN.fullmatch(name):
            raise ValueError("expected small letters, digits and _")
        return name


class SignalMeasure(Window):
    """A [[measure]] of one signal."""

    signal: str = setting(
        examples=["plant.p_B[2]"],
        json_schema_extra=_SIGNAL_SCHEMA,
        help='one component of a recorded signal, such as plant.p_B[2]; a "-" before it inverts the sign',
    )

    @field_validator("signal", "reference", check_fields=False)
    @classmethod
    def _check_signal(cls, signal: str) -> str:
        if not SIGNAL_PATTERN.fullmatch(signal):
            raise ValueError("expected a recorded signal such as plant.p_B[2] or -plant.F_ee_B[2]")
        return signal


class ReferenceMeasure(SignalMeasure):
    """A [[measure]] of a signal and its reference."""

    reference: str = setting(
        examples=["controller.p_ref_B[2]"], json_schema_extra=_SIGNAL_SCHEMA, help="reference signal, written likewise"
    )


class Step(ReferenceMeasure):
    """[[measure]] kind = "step": response of a signal to a step of its reference at `begin_s`."""

    kind: Literal["step"] = MEASURE_KIND


class Tracking(ReferenceMeasure):
    """[[measure]] kind = "tracking": deviation of a signal from its reference."""

    kind: Literal["tracking"] = MEASURE_KIND


class Lag(ReferenceMeasure):
    """[[measure]] kind = "lag": delay of a signal behind its reference, which has to move."""

    kind: Literal["lag"] = MEASURE_KIND
    longest: float = setting("s", default=2.0, gt=0, help="maximum lag; at most half the window")


class SpreadMeasure(SignalMeasure):
    """[[measure]] kind = "spread": mean and standard deviation of a signal."""

    kind: Literal["spread"] = MEASURE_KIND


class Oscillation(SignalMeasure):
    """[[measure]] kind = "oscillation": strongest sine in a signal."""

    kind: Literal["oscillation"] = MEASURE_KIND
    lowest: float = setting("Hz", default=1.0, gt=0, help="minimum frequency; four periods of it must fit the window")


class Onset(SignalMeasure):
    """[[measure]] kind = "onset": earliest time of a boolean signal being true."""

    kind: Literal["onset"] = MEASURE_KIND


class Path(Window):
    """[[measure]] kind = "path": distance of the true platform from the reference's path, regardless of timing."""

    kind: Literal["path"] = MEASURE_KIND


class Effort(Window):
    """[[measure]] kind = "effort": total motion of the motors by their commands, and work of their shafts."""

    kind: Literal["effort"] = MEASURE_KIND


class RequirementMeasure(Window):
    """[[measure]] kind = "requirement": robustness of a formula, its distance from violation."""

    kind: Literal["requirement"] = MEASURE_KIND
    formula: str = setting(
        examples=["always (|plant.F_ee_B| <= 18 N)"], help="condition to satisfy; docs/faults.md describes formulas"
    )

    @field_validator("formula")
    @classmethod
    def _check_formula(cls, formula: str) -> str:
        parse_requirement(formula)
        return formula


Measure = Step | Tracking | Lag | SpreadMeasure | Oscillation | Onset | Path | Effort | RequirementMeasure
MEASURE_KINDS: dict[str, type[Measure]] = {
    "step": Step, "tracking": Tracking, "lag": Lag, "spread": SpreadMeasure, "oscillation": Oscillation, "onset": Onset,
    "path": Path, "effort": Effort, "requirement": RequirementMeasure,
}  # fmt: skip


def checked_measures(tables: Any, duration: float, mistakes: list[str]) -> tuple[Measure, ...]:
    """Check the [[measure]] tables of an experiment of the given duration (s); return the valid measures.

    `tables` is the array from the file; () if missing.
    """
    measures: list[Measure] = []
    for number, table in numbered_tables(tables, "measure", mistakes):
        measure = check_kind(MEASURE_KINDS, table, f"measure {number}", mistakes)
        if measure is None:
            continue
        until = duration if measure.until is None else measure.until
        if until > duration:
            mistakes.append(f"[measure {number}] until_s = {until:g}: after the end at {duration:g} s")
        elif measure.begin >= until:
            mistakes.append(f"[measure {number}] begin_s = {measure.begin:g}: expected a time before {until:g} s")
        elif isinstance(measure, Lag) and until - measure.begin < 2.0 * measure.longest - 1e-9:
            length = until - measure.begin
            mistakes.append(
                f"[measure {number}] longest_s = {measure.longest:g}: {length:g} s are too short for such lags; "
                "expected at most half of that"
            )
        if measure.name in [other.name for other in measures]:
            mistakes.append(f'[measure {number}] name = "{measure.name}": another measure has that name')
        measures.append(measure)
    return tuple(measures)
