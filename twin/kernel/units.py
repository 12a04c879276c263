"""Units: dimensions and conversion to SI, for TOML keys, columns of logs and variables of FMUs.

Two spellings are read: that of a TOML key (`mm_per_s`, `Nm_per_rad`) and that of a table's heading (`mm/s`, `N m/rad`,
`m/s^2`). Factors are exact: SI Brochure, 9th edition, tables 2, 4, 7 and 8; kgf by the standard gravity of CGPM 1901.
"""

import math
import re
from fractions import Fraction
from typing import Any, NamedTuple

_KGF = Fraction("9.80665")
_PREFIXED_UNITS = ("m", "s", "g", "N", "gf", "Nm", "J", "A", "V", "W", "rad", "Hz")
MAX_UNIT_LENGTH = 40
"""Maximum length of a unit (characters); a longer one could multiply to more than a float can represent."""
_UNIT_WORD = re.compile(r"(.*?[^0-9^-])\^?(-?[1-9])?")
_SI_PREFIXES: dict[str, Fraction] = {"k": Fraction(1000), "c": Fraction(1, 100), "m": Fraction(1, 1000)}


class Dimension(NamedTuple):
    """Dimension of a physical unit: exponents of the base units.

    The radian is one of them: 1 Hz is 2 pi rad/s, and confusing them is common. Only FMUs omit it, as tools disagree
    whether rad/s is 1/s (FMI 2.0, 2.2.2): see `twin.kernel.fmi.units`.
    """

    kg: int = 0
    m: int = 0
    s: int = 0
    A: int = 0
    K: int = 0
    mol: int = 0
    cd: int = 0
    rad: int = 0


class Unit(NamedTuple):
    """A unit of `dimension`: SI value = value * factor * pi^pi."""

    dimension: Dimension
    factor: Fraction = Fraction(1)
    pi: int = 0

    @property
    def si(self) -> str:
        """Name of the SI unit of the same dimension, as in recordings: `N m`, `rad/s`; `1` for a number."""
        if self.dimension in _SI_NAMES:
            return _SI_NAMES[self.dimension]
        parts = [f"{name}{power if power != 1 else ''}" for name, power in self.dimension._asdict().items() if power]
        return " ".join(parts)

    @property
    def scale(self) -> float:
        """SI value of one unit: the conversion factor."""
        return math.pi**self.pi * self.factor.numerator / self.factor.denominator

    def in_si(self, values: Any) -> Any:
        """Convert `values` in this unit (a number, an array or nested tuples of numbers) to SI.

        Powers of ten are one correctly rounded division, so that -101 mm is exactly the float -0.101.
        """
        if isinstance(values, tuple):
            return tuple(map(self.in_si, values))
        return values * self.scale if self.pi else values * self.factor.numerator / self.factor.denominator


NUMBER, FORCE, TORQUE = Dimension(), Dimension(kg=1, m=1, s=-2), Dimension(kg=1, m=2, s=-2)
POWER, CURRENT, TEMPERATURE = Dimension(kg=1, m=2, s=-3), Dimension(A=1), Dimension(K=1)
VOLTAGE = POWER._replace(A=-1)
UNIT_SYMBOLS = {
    "1": Unit(NUMBER),
    "%": Unit(NUMBER, Fraction(1, 100)),
    "m": Unit(Dimension(m=1)),
    "s": Unit(Dimension(s=1)),
    "min": Unit(Dimension(s=1), Fraction(60)),
    "Hz": Unit(Dimension(s=-1)),
    "g": Unit(Dimension(kg=1), Fraction(1, 1000)),
    "N": Unit(FORCE),
    "gf": Unit(FORCE, _KGF / 1000),
    "Nm": Unit(TORQUE),
    "J": Unit(TORQUE),
    "A": Unit(CURRENT),
    "V": Unit(VOLTAGE),
    "W": Unit(POWER),
    "K": Unit(TEMPERATURE),
    "rad": Unit(Dimension(rad=1)),
    "deg": Unit(Dimension(rad=1), Fraction(1, 180), 1),
    "\N{DEGREE SIGN}": Unit(Dimension(rad=1), Fraction(1, 180), 1),
    "rev": Unit(Dimension(rad=1), Fraction(2), 1),
    "rpm": Unit(Dimension(rad=1, s=-1), Fraction(2, 60), 1),
}
_SI_PREFIXES |= {small: Fraction(1, 10**6) for small in ("u", "\N{MICRO SIGN}", "\N{GREEK SMALL LETTER MU}")}
_SI_PREFIXES["n"] = Fraction(1, 10**9)
UNIT_SYMBOLS |= {
    prefix + name: UNIT_SYMBOLS[name]._replace(factor=UNIT_SYMBOLS[name].factor * scale)
    for prefix, scale in _SI_PREFIXES.items()
    for name in _PREFIXED_UNITS
}
_SI_NAMES = {
    NUMBER: "1",
    FORCE: "N",
    TORQUE: "N m",
    POWER: "W",
    VOLTAGE: "V",
    Dimension(m=1, s=-1): "m/s",
    Dimension(m=1, s=-2): "m/s2",
    Dimension(rad=1, s=-1): "rad/s",
    Dimension(rad=1, s=-2): "rad/s2",
    Dimension(rad=1, m=-1): "rad/m",
    Dimension(kg=1, s=-2): "N/m",
    TORQUE._replace(rad=-1): "N m/rad",
    Dimension(s=-1): "1/s",
}


def known_unit(text: str) -> Unit | None:
    """Parse the unit `text`; None if unknown."""
    if len(text) > MAX_UNIT_LENGTH:
        return None
    dimension = NUMBER
    factor, pi, sign = Fraction(1), 0, 1
    words = [w for w in re.split(r"[ _*.\N{MIDDLE DOT}]+|(/)", text.strip()) if w]
    for word in words:
        if word in ("/", "per"):
            sign = -1
            continue
        match = _UNIT_WORD.fullmatch(word)
        name, power = (match[1], int(match[2] or 1)) if match and word not in UNIT_SYMBOLS else (word, 1)
        if name not in UNIT_SYMBOLS:
            return None
        atom = UNIT_SYMBOLS[name]
        power *= sign
        dimension = Dimension(*(d + power * e for d, e in zip(dimension, atom.dimension, strict=True)))
        factor *= atom.factor**power
        pi += power * atom.pi
    return Unit(dimension, factor, pi) if words and words[-1] not in ("/", "per") else None


def parse_float(text: str) -> float | None:
    """Parse a number of ASCII characters, NaN and infinity included; None for other text.

    `float` also reads `1_000` and digits of all scripts; one rule for all texts but TOML refuses both.
    """
    try:
        return float(text) if has_plain_digits(text.strip()) else None
    except ValueError:
        return None


def has_plain_digits(text: str) -> bool:
    """Whether numbers in `text` have neither underscores nor digits outside ASCII."""
    return text.isascii() and "_" not in text


def weight_hint(got: Dimension, wanted: Dimension) -> str:
    """Return a hint if a mass unit was given where its weight is expected: `; grams are a mass: ...`; else ""."""
    if got.kg == 0 or got == wanted:
        return ""
    as_weight = Dimension(*(g + got.kg * f for g, f in zip(got._replace(kg=0), FORCE, strict=True)))
    return "; grams are a mass: did you mean gf (or kgf)?" if as_weight == wanted else ""
