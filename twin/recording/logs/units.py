"""Units of columns: what they measure and how values become SI.

Both spellings are read: that of a TOML key (`mm_per_s`, `Nm_per_rad`) and that of a table's head (`mm/s`, `N m/rad`,
`m/s^2`). Factors are exact: SI Brochure, 9th edition, tables 2, 4, 7 and 8; kgf by the standard gravity of CGPM 1901.
"""

import math
import re
from fractions import Fraction
from typing import NamedTuple, TypeVar

import numpy as np
from numpy.typing import NDArray

from twin.errors import nearest
from twin.recording.logs.errors import LogRefused

Values = TypeVar("Values", float, NDArray[np.float64])


class Dimension(NamedTuple):
    """Exponents of the base units. The radian is one of them: 1 Hz is 2 pi rad/s, and mistaking them is common."""

    kg: int = 0
    m: int = 0
    s: int = 0
    A: int = 0
    K: int = 0
    rad: int = 0


class Unit(NamedTuple):
    """SI value = value * factor * pi^pi, of a quantity of `dimension`."""

    dimension: Dimension
    factor: Fraction = Fraction(1)
    pi: int = 0

    @property
    def si(self) -> str:
        """The SI unit of the same dimension as recordings write it: `N m`, `rad/s`; `1` for a number."""
        if self.dimension in _SI_NAMES:
            return _SI_NAMES[self.dimension]
        parts = [f"{name}{power if power != 1 else ''}" for name, power in self.dimension._asdict().items() if power]
        return " ".join(parts)

    def in_si(self, values: Values) -> Values:
        """`values` in SI; powers of ten as one correctly rounded division, as in `twin.experiment.quantity`."""
        scaled = values * self.factor.numerator / self.factor.denominator
        return scaled * math.pi**self.pi if self.pi else scaled


_NUMBER, _FORCE = Dimension(), Dimension(kg=1, m=1, s=-2)
_TORQUE, _POWER = Dimension(kg=1, m=2, s=-2), Dimension(kg=1, m=2, s=-3)
_KGF = Fraction("9.80665")
_ATOMS = {
    "1": Unit(_NUMBER),
    "%": Unit(_NUMBER, Fraction(1, 100)),
    "m": Unit(Dimension(m=1)),
    "s": Unit(Dimension(s=1)),
    "min": Unit(Dimension(s=1), Fraction(60)),
    "Hz": Unit(Dimension(s=-1)),
    "g": Unit(Dimension(kg=1), Fraction(1, 1000)),
    "N": Unit(_FORCE),
    "gf": Unit(_FORCE, _KGF / 1000),
    "Nm": Unit(_TORQUE),
    "A": Unit(Dimension(A=1)),
    "V": Unit(_POWER._replace(A=-1)),
    "W": Unit(_POWER),
    "K": Unit(Dimension(K=1)),
    "rad": Unit(Dimension(rad=1)),
    "deg": Unit(Dimension(rad=1), Fraction(1, 180), 1),
    "\N{DEGREE SIGN}": Unit(Dimension(rad=1), Fraction(1, 180), 1),
    "rev": Unit(Dimension(rad=1), Fraction(2), 1),
    "rpm": Unit(Dimension(rad=1, s=-1), Fraction(2, 60), 1),
}
_PREFIXES: dict[str, Fraction] = {"k": Fraction(1000), "c": Fraction(1, 100), "m": Fraction(1, 1000)}
_PREFIXES |= {small: Fraction(1, 10**6) for small in ("u", "\N{MICRO SIGN}", "\N{GREEK SMALL LETTER MU}")}
_PREFIXES["n"] = Fraction(1, 10**9)
_PREFIXED = ("m", "s", "g", "N", "gf", "Nm", "A", "V", "W", "rad", "Hz")
_ATOMS |= {
    prefix + name: _ATOMS[name]._replace(factor=_ATOMS[name].factor * scale)
    for prefix, scale in _PREFIXES.items()
    for name in _PREFIXED
}
_SI_NAMES = {
    _NUMBER: "1",
    _FORCE: "N",
    _TORQUE: "N m",
    _POWER: "W",
    _POWER._replace(A=-1): "V",
    Dimension(m=1, s=-1): "m/s",
    Dimension(m=1, s=-2): "m/s2",
    Dimension(rad=1, s=-1): "rad/s",
    Dimension(rad=1, s=-2): "rad/s2",
    Dimension(rad=1, m=-1): "rad/m",
    Dimension(kg=1, s=-2): "N/m",
    _TORQUE._replace(rad=-1): "N m/rad",
    Dimension(s=-1): "1/s",
}
LONGEST = 40
"""Characters of a unit; the words of a longer one would multiply to more than a float holds."""
_WORD = re.compile(r"(.*?[^0-9^-])\^?(-?[1-9])?")


def known_unit(text: str) -> Unit | None:
    """The unit that `text` spells; None if there is no such unit."""
    if len(text) > LONGEST:
        return None
    dimension: list[int] = list(_NUMBER)
    factor, pi, sign = Fraction(1), 0, 1
    words = [w for w in re.split(r"[ _*.\N{MIDDLE DOT}]+|(/)", text.strip()) if w]
    for word in words:
        if word in ("/", "per"):
            sign = -1
            continue
        match = _WORD.fullmatch(word)
        name, power = (match[1], int(match[2] or 1)) if match and word not in _ATOMS else (word, 1)
        if name not in _ATOMS:
            return None
        atom = _ATOMS[name]
        power *= sign
        dimension = [d + power * e for d, e in zip(dimension, atom.dimension, strict=True)]
        factor *= atom.factor**power
        pi += power * atom.pi
    return Unit(Dimension(*dimension), factor, pi) if words and words[-1] not in ("/", "per") else None


def unit(text: str, where: str) -> Unit:
    """The unit that `text` spells.

    Args:
        text: `mm`, `rad/s`, `deg_per_s`.
        where: begins the sentence of the refusal: file and column.

    Raises:
        LogRefused: there is no such unit; it names the nearest.
    """
    found = known_unit(text)
    if found is None:
        hint = nearest(text, _ATOMS, "expected one such as mm, N, deg, rad/s, Nm, ms, A or 1")
        raise LogRefused(f"{where}: unknown unit '{text}'; {hint}")
    return found
