"""A variable of an FMU as its model description has it: type, unit, values that have names."""

import math
from collections.abc import Mapping
from contextlib import suppress
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import Any, NamedTuple

from twin.kernel.errors import InputRefused, nearest
from twin.kernel.units import TEMPERATURE, Dimension, Unit, known_unit

KINDS = ("Float64", "Float32", "Int8", "UInt8", "Int16", "UInt16", "Int32", "UInt32", "Int64", "UInt64", "Boolean")
"""The types of FMI 3.0 that hold numbers, by which a variable of any version is kept: its `kind` is the index."""

ITEM_SIZES = (8, 4, 1, 1, 2, 2, 4, 4, 8, 8, 1)
"""Bytes of one value of each of `KINDS`."""


class Conversion(NamedTuple):
    """SI value = factor * value + offset, of a quantity of `dimension`."""

    dimension: Dimension
    factor: float = 1.0
    offset: float = 0.0


SPEED = Dimension(s=-1)
TURN = 2.0 * math.pi

SPELLED = (
    "1", "rad", "deg", "\N{DEGREE SIGN}", "rev", "rad/s", "deg/s", "rev/s", "rpm", "rev/min", "N.m", "N m", "Nm", "N*m",
    "mN.m", "mN m", "mNm", "mN*m", "N.cm", "A", "mA", "V", "mV", "W", "K",
)  # fmt: skip
"""As `twin.kernel.units` does."""
OTHERWISE = {"": "1", "degree": "deg", "r": "rev", "turn": "rev", "r/s": "rev/s", "Ncm": "N.cm"}
# SI Brochure, 2.3.4: hertz is for frequencies, what turns has rad/s; in hertz it counts turns, as per minute
OTHERWISE |= {"Hz": "rev/s", "kHz": "rev/ms", "rps": "rev/s", "1/min": "rpm", "r/min": "rpm", "U/min": "rpm"}
ENERGY = ("J", "kJ", "mJ", "Wh", "kWh")
"""In kg m2/s2 as torques are, and no torque."""


def _without_radian(unit: Unit | None) -> Conversion:
    assert unit is not None
    return Conversion(unit.dimension._replace(rad=0), unit.scale)


KNOWN = {name: _without_radian(known_unit(OTHERWISE.get(name, name))) for name in (*SPELLED, *OTHERWISE)}
KNOWN |= dict.fromkeys(("degC", "\N{DEGREE SIGN}C"), Conversion(TEMPERATURE, 1.0, 273.15))
"""What a unit's name means where the FMU does not define it, or defines it in turns instead of radians."""


def conversion(unit: str, definitions: list[Any]) -> Conversion | None:
    """How values in `unit` become SI; None if neither the FMU's `definitions` (FMPy's) nor custom knows the unit."""
    for definition in definitions:
        if definition.name == unit and definition.baseUnit is not None:
            base = definition.baseUnit
            dimension = Dimension(*(int(getattr(base, name) or 0) for name in Dimension._fields))
            return meant(unit, Conversion(dimension, float(base.factor), float(base.offset)))
    return meant(unit)


def meant(unit: str, stated: Conversion | None = None) -> Conversion | None:
    """How values in `unit` become SI, of which a file has `stated` so much; None if nobody knows.

    A definition as 1/s with the factor 1/60 (rpm as a frequency) or 1 (Hz) counts turns; the well-known name decides.
    """
    if unit.strip() in ENERGY:
        return None
    known = KNOWN.get(unit.strip())
    if stated is None:
        return known
    stated = stated._replace(dimension=stated.dimension._replace(rad=0))
    if known and known.dimension == stated.dimension and math.isclose(known.factor, TURN * stated.factor):
        return known
    return stated


def named_values(variable: Any) -> dict[str, float]:
    """Name -> value of the enumeration that a variable (FMPy's) is declared as; empty: none, or one without items."""
    declared = variable.declaredType
    if declared is None or variable.type != "Enumeration":
        return {}
    found = {}
    for item in declared.items:
        # an item without a whole number cannot be set
        with suppress(TypeError, ValueError):
            found[str(item.name)] = float(int(item.value))
    return found


def valued(where: str, items: Mapping[str, float], value: float | str) -> float:
    """`value`, which may be one of the names of `items`; if there are some, it has to be one of them.

    Args:
        where: for the sentence.

    Raises:
        InputRefused: it is none of them, or a name where there are none.
    """
    if not items:
        if isinstance(value, str):
            raise InputRefused(f"{where} = {value!r}: expected a number; this variable has no values with names")
        return value
    if value in items.values():
        return float(value)
    known = ", ".join(f"{name} ({number:g})" for name, number in items.items())
    if not isinstance(value, str):
        raise InputRefused(f"{where} = {value:g}: expected one of {known}")
    if value not in items:
        raise InputRefused(f"{where} = {value!r}: {nearest(value, items, f'expected one of {known}')}")
    return items[value]


FMI1_KINDS = {"Real": "Float64", "Integer": "Int32", "Enumeration": "Int32"}
FMI2_KINDS = FMI1_KINDS | {"Boolean": "Int32"}
FMI3_KINDS = {"Enumeration": "Int64"}
"""How types travel, in words of FMI 3.0. Boolean is four bytes wide in FMI 2.0 and one in the others."""

TEXTS = ("String", "Binary")
"""Types whose values are no numbers."""

MOST_VALUES = 1_000_000
"""Of one array: no drive has more, and a file that says so would fill the memory."""


@dataclass(frozen=True)
class Variable:
    """A variable of an FMU.

    Attributes:
        name, causality, description: as the FMU has them.
        type: as the FMU has it, "Real" or "Float64".
        kind: index into `KINDS`; -1: text or binary.
        reference: FMI value reference.
        size: number of values, > 1 for an array.
        unit: as the FMU has it, "" where it states none.
        conversion: to SI; None: unit unknown or not stated.
        start, low, high: as the FMU has them, in its own unit; NaN: not stated.
        variability: as the FMU has it.
        dimensions: of an array, each a number or the name of the structural parameter that says it.
        clocks: value references of the clocks with which alone it changes.
        intermediate: whether it may be set within a step.
        items: values that have names, by these; none, but of an enumeration.
    """

    name: str
    causality: str
    description: str
    type: str
    kind: int
    reference: int
    size: int
    unit: str
    conversion: Conversion | None
    start: float
    low: float
    high: float
    variability: str = "continuous"
    dimensions: tuple[int | str, ...] = ()
    clocks: tuple[int, ...] = ()
    intermediate: bool = False
    items: Mapping[str, float] = field(default_factory=dict, hash=False)

    @property
    def is_text(self) -> bool:
        return self.type in TEXTS

    def told(self, value: float) -> str:
        """`value` for people: by its name, if it has one."""
        return next((name for name, number in self.items.items() if number == value), f"{value:g}")

    def resized(self, file: Path, structure: Mapping[str, float]) -> "Variable":
        """The same variable where the structural parameters have the values of `structure`.

        Raises:
            InputRefused: it would have no values, or too many.
        """
        if not self.dimensions:
            return self
        sizes = [structure[d] if isinstance(d, str) else d for d in self.dimensions]
        size = math.prod(sizes)
        if not 1 <= size <= MOST_VALUES:
            asked = " x ".join(f"{s:g}" for s in sizes)
            raise InputRefused(f"{file}: '{self.name}' would have {asked} values; expected 1 .. {MOST_VALUES}")
        return replace(self, size=round(size))


def variable_of(v: Any, model: Any) -> Variable:
    """What FMPy has read of a variable; an array has the size that its structural parameters start with."""
    declared = v.declaredType
    unit = v.unit or (declared.unit if declared is not None else None) or ""
    kind = {"1": FMI1_KINDS, "2": FMI2_KINDS}.get(model.fmiVersion[0], FMI3_KINDS).get(v.type, v.type)
    return Variable(
        name=v.name,
        causality=v.causality or "local",
        description=v.description or "",
        type=v.type,
        kind=KINDS.index(kind) if kind in KINDS else -1,
        reference=v.valueReference,
        size=1,
        unit=unit,
        conversion=conversion(unit, model.unitDefinitions) if unit else None,
        start=number(v.start),
        low=number(v.min),
        high=number(v.max),
        variability=v.variability or "continuous",
        dimensions=tuple(d.variable.name if d.start is None else int(d.start) for d in v.dimensions or ()),
        clocks=tuple(clock.valueReference for clock in v.clocks or ()),
        intermediate=v.intermediateUpdate,
        items=named_values(v),
    )


def number(text: Any) -> float:
    """Of an attribute; NaN if it is not stated or none."""
    if text in ("true", "false"):
        return float(text == "true")
    try:
        return float(text)
    except (TypeError, ValueError):
        return math.nan
