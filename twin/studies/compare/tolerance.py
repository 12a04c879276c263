"""How far a signal may be off, in value and in time: the grammar of `--tol`.

A rule is SIGNAL = "VALUE UNIT", "SHARE %" or either with "@ TIME"; only "@ TIME" leaves the value as it was. A share
is of the reference's range. SIGNAL may hold * and ?; a vector's name means all of its components. Rules stand in a
TOML file, in texts on the command line, or both; of those that fit a signal the last one that says something wins:

    "*" = "2 % @ 4 ms"
    "controller.F_z" = "0.05 N"
    "plant.p_B" = "0.1 mm @ 10 ms"

    --tol 2%@4ms  --tol controller.F_z=0.05N  --tol 'plant.*=0.1mm@10ms'
"""

import math
import re
from collections.abc import Iterable, Sequence
from dataclasses import dataclass
from fnmatch import fnmatchcase
from pathlib import Path

from twin.errors import InputRefused
from twin.files import read_toml
from twin.units import Dimension, Unit, known_unit, weight_hint

SECONDS = Dimension(s=1)
_RULE = re.compile(r"\s*(?:([0-9.eE+-]+)\s*([^@]*?))?\s*(?:@\s*([0-9.eE+-]+)\s*(\S+))?\s*")


class ComparisonRefused(InputRefused):
    """Two logs, or the tolerances for them, do not fit together: what was found, what was expected, what to do."""


@dataclass(frozen=True)
class Rule:
    """What is allowed for the signals that fit a pattern.

    Attributes:
        pattern: name with * and ?; a vector's name without index fits its components.
        value: half width, in SI; None: not said here.
        dimension: of value; None: value is a share of the range.
        dt: half width in time, s; None: not said here.
    """

    pattern: str
    value: float | None = None
    dimension: Dimension | None = None
    dt: float | None = None

    def fits(self, signal: str) -> bool:
        """Whether the rule is about `signal`."""
        return matches(self.pattern, signal)


DEFAULT = Rule("*", 0.02, None, 0.004)
"""2 % of the range, and two periods of the robot's controller (2 ms)."""


@dataclass(frozen=True)
class Allowance:
    """What the rules come to for one signal: half widths of its tube, value in SI and time in s."""

    value: float
    dt: float


def matches(pattern: str, signal: str) -> bool:
    """Whether `signal`, or the vector that it is a component of, fits `pattern` with * and ?."""
    # brackets are indices here, not classes of characters
    literal = pattern.replace("[", "[[]")
    return fnmatchcase(signal, literal) or fnmatchcase(signal.partition("[")[0], literal)


def rules(entries: Sequence[str | Path]) -> tuple[Rule, ...]:
    """Rules from the texts and TOML files in `entries`, in their order.

    Raises:
        ComparisonRefused: a file or text that makes no rule; all mistakes at once.
    """
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
        raise ComparisonRefused("\n".join(mistakes))
    return tuple(found)


def allowance(signal: str, unit: Unit, span: float, magnitude: float, given: Iterable[Rule]) -> Allowance:
    """What `given` rules, after DEFAULT, allow `signal`.

    Args:
        signal: its name.
        unit: of its values.
        span: range of the reference, that of the widest component for a component of a vector, SI.
        magnitude: largest of the reference's absolute values, SI; a share of the range also allows 1e-9 of it, so
            that numbers written with ten digits are equal to those they were.

    Raises:
        ComparisonRefused: a rule that names this signal without * or ? is in another dimension.
    """
    value, dt = 0.0, 0.0
    for rule in (DEFAULT, *given):
        if not rule.fits(signal):
            continue
        if rule.value is not None and rule.dimension is None:
            value = rule.value * span + 1e-9 * magnitude
        elif rule.value is not None and rule.dimension == unit.dimension:
            value = rule.value
        elif rule.value is not None and not set("*?") & set(rule.pattern):
            got = rule.dimension or Dimension()
            raise ComparisonRefused(
                f"tolerance of {rule.pattern} is in {Unit(got).si}, but it is in {unit.si}"
                f"{weight_hint(got, unit.dimension)}"
            )
        dt = dt if rule.dt is None else rule.dt
    return Allowance(value, dt)


def _table(path: Path, mistakes: list[str]) -> dict[str, object]:
    """`"controller.F_z" = TEXT` of a TOML file; unquoted dots in a name have made tables of tables."""
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
    said = f"{where}: {pattern} = {text!r}" if where != "--tol" else f"--tol {pattern}={text}"
    match = _RULE.fullmatch(text) if isinstance(text, str) and text.strip() else None
    try:
        numbers = [float(part) if part is not None else None for part in (match[1], match[3])] if match else []
    except ValueError:
        numbers = []
    if not match or not pattern or not numbers or any(n is not None and not 0.0 <= n < math.inf for n in numbers):
        mistakes.append(f"{said}: expected VALUE UNIT, SHARE % or @ TIME, such as 0.05 N @ 4 ms")
        return
    value, dt = numbers
    unit, stamp = match[2] or "", match[4] or "s"
    time_unit = known_unit(stamp)
    if time_unit is None or time_unit.dimension != SECONDS:
        mistakes.append(f"{said}: time in '{stamp}'; expected s, ms or us")
        return
    dt = None if dt is None else time_unit.in_si(dt)
    if value is None or unit == "%":
        found.append(Rule(pattern, None if value is None else value / 100.0, None, dt))
        return
    value_unit = known_unit(unit or "1")
    if value_unit is None:
        mistakes.append(f"{said}: unknown unit '{unit}'; expected one such as N, mm, deg, rad/s or %")
        return
    found.append(Rule(pattern, value_unit.in_si(value), value_unit.dimension, dt))
