"""Variables of an FMU from its model description: types, units, enumerations, values."""

import hashlib
import math
import os
from collections.abc import Mapping, Sequence
from contextlib import suppress
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np

from twin.kernel.archive import sha256
from twin.kernel.errors import InputRefused, nearest
from twin.kernel.files import read_bytes
from twin.kernel.ssp.structure import REAL_TYPES, ParameterValue, UnitDefinition
from twin.kernel.units import TEMPERATURE, Dimension, Unit, known_unit, parse_float

_INTEGERS = [f"{sign}Int{bits}" for bits in (8, 16, 32, 64) for sign in ("", "U")]
NUMERIC_TYPES = ("Float64", "Float32", *_INTEGERS, "Boolean")
"""Numeric types of FMI 3.0, which represent variables of all FMI versions; `Variable.kind` is the index."""

ITEM_SIZES = (8, 4, 1, 1, 2, 2, 4, 4, 8, 8, 1)
"""Size of a value of each of `NUMERIC_TYPES` (bytes)."""

MAX_EXACT = 2**53
"""Largest integer up to which a double represents every integer; signals are doubles."""
FLOAT_64, FLOAT_32 = float(np.finfo(np.float64).max), float(np.finfo(np.float32).max)
LOWEST_VALUES = (-FLOAT_64, -FLOAT_32, -(2.0**7), 0.0, -(2.0**15), 0.0, -(2.0**31), 0.0, -(2.0**53), 0.0, 0.0, 0.0)
HIGHEST_VALUES = (
    FLOAT_64, FLOAT_32,
    2.0**7 - 1, 2.0**8 - 1, 2.0**15 - 1, 2.0**16 - 1, 2.0**31 - 1, 2.0**32 - 1, 2.0**53, 2.0**53, 1.0, 1.0,
)  # fmt: skip
"""Bounds of `NUMERIC_TYPES`, then of FMI 2.0's Boolean. 64-bit integers end where a double is no longer exact."""
SPEED_DIMENSION = Dimension(s=-1)
RAD_PER_TURN = 2.0 * math.pi
UNIT_NAMES = (
    "1", "rad", "deg", "\N{DEGREE SIGN}", "rev", "rad/s", "deg/s", "rev/s", "rpm", "rev/min", "N.m", "N m", "Nm", "N*m",
    "mN.m", "mN m", "mNm", "mN*m", "N.cm", "A", "mA", "V", "mV", "W", "K",
)  # fmt: skip
"""Unit names with the meaning of `twin.kernel.units`."""
UNIT_ALIASES = {"": "1", "degree": "deg", "r": "rev", "turn": "rev", "r/s": "rev/s", "Ncm": "N.cm"}
# SI Brochure, 2.3.4: hertz is for frequencies, and rotation is in rad/s; a rotation in hertz counts turns, like rpm
UNIT_ALIASES |= {"Hz": "rev/s", "kHz": "rev/ms", "rps": "rev/s", "1/min": "rpm", "r/min": "rpm", "U/min": "rpm"}
ENERGY_UNITS = ("J", "kJ", "mJ", "Wh", "kWh")
"""Energy units, which have the base units of torque (kg m2/s2) and are not accepted as torques."""
FMI1_KINDS = {"Real": "Float64", "Integer": "Int32", "Enumeration": "Int32"}
FMI2_KINDS = FMI1_KINDS | {"Boolean": "Int32"}
FMI3_KINDS = {"Enumeration": "Int64"}
"""Representation of FMI 1.0 to 3.0 types as `NUMERIC_TYPES`; a Boolean has four bytes in FMI 2.0, one in the others."""
TEXT_TYPES = ("String", "Binary")
MAX_ARRAY_VALUES = 1_000_000
"""Maximum number of values of an array; a malicious file could otherwise exhaust the memory."""
FILE_PREFIX = "file:"
"""Prefix of a file path in the value of a String (the path) or a Binary (the content of the file)."""
MAX_BINARY_SIZE = 64 << 20
"""Maximum size of a file for a Binary (bytes)."""
Value = float | str | Sequence[float] | Sequence[str]
"""Value of a parameter in an experiment; an array takes one value for all elements, or one for each."""


class Conversion(NamedTuple):
    """A conversion from a unit to SI: SI value = factor * value + offset, of a quantity of `dimension`."""

    dimension: Dimension
    factor: float = 1.0
    offset: float = 0.0


def _without_radian(unit: Unit | None) -> Conversion:
    assert unit is not None
    return Conversion(unit.dimension._replace(rad=0), unit.scale)


KNOWN_UNITS = {name: _without_radian(known_unit(UNIT_ALIASES.get(name, name))) for name in (*UNIT_NAMES, *UNIT_ALIASES)}
KNOWN_UNITS |= dict.fromkeys(("degC", "\N{DEGREE SIGN}C"), Conversion(TEMPERATURE, 1.0, 273.15))
"""Units used if the FMU does not define a unit, or defines it in turns instead of radians."""


def conversion(unit: str, definitions: list[Any]) -> Conversion | None:
    """Return the conversion of `unit` to SI, by the FMU's `definitions` or well-known names; None if unknown."""
    for definition in definitions:
        if definition.name == unit and definition.baseUnit is not None:
            base = definition.baseUnit
            dimension = Dimension(*(int(getattr(base, name) or 0) for name in Dimension._fields))
            return si_conversion(unit, Conversion(dimension, float(base.factor), float(base.offset)))
    return si_conversion(unit)


def si_conversion(unit: str, stated: Conversion | None = None) -> Conversion | None:
    """Return the conversion of `unit` to SI, by its definition in a file or its well-known name; None if unknown.

    A `stated` definition is used unless the well-known unit counts turns. A definition as 1/s with the factor 1/60 (rpm
    as a frequency) or 1 (Hz) counts turns.
    """
    if unit.strip() in ENERGY_UNITS:
        return None
    known = KNOWN_UNITS.get(unit.strip())
    if stated is None:
        return known
    stated = stated._replace(dimension=stated.dimension._replace(rad=0))
    if known and known.dimension == stated.dimension and math.isclose(known.factor, RAD_PER_TURN * stated.factor):
        return known
    return stated


def enumeration_items(variable: Any) -> dict[str, float]:
    """Return item name -> value of the enumeration type of an FMU variable (FMPy's); empty for other types."""
    declared = variable.declaredType
    if declared is None or variable.type != "Enumeration":
        return {}
    found = {}
    for item in declared.items:
        # skip an item without an integer value, as it cannot be set
        with suppress(TypeError, ValueError):
            found[str(item.name)] = float(int(item.value))
    return found


def item_list(items: Mapping[str, float]) -> str:
    """Return `one (1), two (2)` for the items of an enumeration; "" without items."""
    return ", ".join(f"{name} ({number:.0f})" for name, number in items.items())


def parse_value(where: str, items: Mapping[str, float], value: float | str) -> float:
    """Convert an FMU variable's value to a number; the name of an item counts if there are `items` (an enumeration)."""
    if not items:
        if isinstance(value, str):
            raise InputRefused(f"{where} = {value!r}: expected a number; this variable has no values with names")
        return value
    if value in items.values():
        return float(value)
    known = item_list(items)
    if not isinstance(value, str):
        raise InputRefused(f"{where} = {value:g}: expected one of {known}")
    if value not in items:
        raise InputRefused(f"{where} = {value!r}: {nearest(value, items, f'expected one of {known}')}")
    return items[value]


@dataclass(frozen=True)
class Variable:
    """A variable of an FMU, with its type, unit, bounds and enumeration items.

    Attributes:
        name, causality, description, type, variability: as in the model description; type is "Real" or "Float64".
        kind: index into `NUMERIC_TYPES`; -1 for text or binary.
        size: number of values, > 1 for an array.
        unit: unit in the model description, "" if not stated.
        conversion: conversion to SI; None if the unit is unknown or not stated.
        start, low, high: start value and bounds in the model description, in its own unit; NaN if not stated.
        dimensions: sizes of an array: numbers, or names of structural parameters.
        clocks: value references of the clocks at whose ticks alone it changes.
        intermediate: whether it may be set within a step.
        items: enumeration item name -> value; empty for other types.
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
        return self.type in TEXT_TYPES

    @property
    def bounds(self) -> tuple[float, float]:
        """Smallest and largest value of the variable's type; for 64-bit integers, of those exact in a double."""
        kind = -1 if self.type == "Boolean" else self.kind
        return LOWEST_VALUES[kind], HIGHEST_VALUES[kind]

    @property
    def range_phrase(self) -> str:
        """Phrase for the type of the variable and its range: `which is UInt8 (0 .. 255)`."""
        low, high = self.bounds
        return f"which is {self.type} ({item_list(self.items) or f'{low:.17g} .. {high:.17g}'})"

    def range_error(self, value: float) -> str:
        """Return why `value` is outside the range of the variable's type: `in8 is UInt8; expected 0 .. 255`; or ""."""
        low, high = self.bounds
        # an int is compared without conversion, as a double may round it
        whole = self.type in REAL_TYPES or isinstance(value, int) or not abs(value) < MAX_EXACT // 2
        arrived = value if whole else math.floor(value + 0.5)
        if self.items:
            known = item_list(self.items)
            return "" if arrived in self.items.values() else f"{self.name} is {self.type}; expected {known}"
        if low <= arrived <= high:
            return ""
        why = ", which doubles hold exactly" if self.kind in (8, 9) else ""
        return f"{self.name} is {self.type}; expected {low:.17g} .. {high:.17g}{why}"

    def format_value(self, value: float) -> str:
        """Format a value of the variable for messages: the name of the enumeration item, else the number."""
        return next((name for name, number in self.items.items() if number == value), f"{value:g}")

    def with_size(self, file: Path, structure: Mapping[str, float]) -> "Variable":
        """Return the array variable with the size that values of structural parameters give."""
        if not self.dimensions:
            return self
        sizes = [structure[d] if isinstance(d, str) else d for d in self.dimensions]
        size = math.prod(sizes)
        if not 1 <= size <= MAX_ARRAY_VALUES:
            asked = " x ".join(f"{s:g}" for s in sizes)
            raise InputRefused(f"{file}: '{self.name}' would have {asked} values; expected 1 .. {MAX_ARRAY_VALUES}")
        return replace(self, size=round(size))


def variable_of(v: Any, model: Any) -> Variable:
    """Convert an FMU variable of FMPy to a `Variable`; start values of structural parameters give array sizes."""
    declared = v.declaredType
    unit = v.unit or (declared.unit if declared is not None else None) or ""
    kind = {"1": FMI1_KINDS, "2": FMI2_KINDS}.get(model.fmiVersion[0], FMI3_KINDS).get(v.type, v.type)
    return Variable(
        name=v.name,
        causality=v.causality or "local",
        description=v.description or "",
        type=v.type,
        kind=NUMERIC_TYPES.index(kind) if kind in NUMERIC_TYPES else -1,
        reference=v.valueReference,
        size=1,
        unit=unit,
        conversion=conversion(unit, model.unitDefinitions) if unit else None,
        start=parse_number(v.start),
        low=parse_number(v.min),
        high=parse_number(v.max),
        variability=v.variability or "continuous",
        dimensions=tuple(d.variable.name if d.start is None else int(d.start) for d in v.dimensions or ()),
        clocks=tuple(clock.valueReference for clock in v.clocks or ()),
        intermediate=v.intermediateUpdate,
        items=enumeration_items(v),
    )


def parse_number(text: Any) -> float:
    """Convert the text of an XML attribute to a number; NaN if missing or invalid."""
    if text in ("true", "false"):
        return float(text == "true")
    number = parse_float(text) if isinstance(text, str) else text
    return math.nan if number is None else float(number)


class Setup(NamedTuple):
    """Data of the run that an FMU gets before initialisation: tolerance, start, stop and step.

    Attributes:
        tolerance: relative tolerance of its solver; None to use the FMU's default.
        stop: end of the last step (s); None to leave it open, with which some FMUs choose their own end.
        step: step size (s), in which its clocks tick; None if unknown, and clocks are refused.
        ramped: whether inputs that allow it are interpolated over a step.
        waiting: whether it remains in initialisation mode until `begin`, so that its inputs can be set to other
            outputs.
        start: start of the first step (s), a whole number of steps.
        lenient: whether missing functions of the binary are accepted unless called.
    """

    tolerance: float | None = None
    stop: float | None = None
    step: float | None = None
    ramped: bool = False
    waiting: bool = False
    start: float = 0.0
    lenient: bool = False


Setting = tuple[Variable, float | np.ndarray | list[str] | list[bytes]]
"""A variable and its value in its own unit; an array takes one value for all elements or one for each."""


class FilePath(str):
    """Text that is the path of a file: the value of a parameter."""


def to_json(value: float | np.ndarray | list[str] | list[bytes]) -> Any:
    """Convert a parameter value to JSON, with files and Binaries represented by SHA-256, independent of location."""
    if isinstance(value, np.ndarray):
        return value.tolist()
    if not isinstance(value, list):
        return value
    texts = [
        f"{len(v)} bytes, sha256 {hashlib.sha256(v).hexdigest()}"
        if isinstance(v, bytes)
        else f"{Path(v).name}, sha256 {sha256(Path(v))}"
        if isinstance(v, FilePath)
        else v
        for v in value
    ]
    return texts[0] if len(texts) == 1 else texts


def setting_value(file: Path, variable: Variable, value: Value) -> float | np.ndarray | list[str] | list[bytes]:
    """Check and convert the user's `value` for the FMU variable `variable` of the FMU `file`."""
    where = f"{file}: parameter {variable.name}"
    given: list[float | str] = list(value) if isinstance(value, Sequence) and not isinstance(value, str) else [value]
    if len(given) not in (1, variable.size):
        raise InputRefused(f"{where}: {len(given)} values; expected {variable.size}, or one for all of them")
    if variable.is_text:
        return [_text(where, variable.type, text) for text in given] * (variable.size // len(given))
    numbers = [_number(where, variable, number) for number in given]
    return numbers[0] if len(numbers) == 1 else np.array(numbers)


def _number(where: str, variable: Variable, value: float | str) -> float:
    value = parse_value(where, variable.items, value)
    low = variable.low if not math.isnan(variable.low) else -math.inf
    high = variable.high if not math.isnan(variable.high) else math.inf
    if not (low <= value <= high and math.isfinite(value)):
        raise InputRefused(f"{where} = {value:g}: expected {low:g} .. {high:g} {variable.unit}".rstrip())
    if why := variable.range_error(value):
        raise InputRefused(f"{where} = {value:.17g}: {why}")
    return float(value)


def _text(where: str, type_name: str, value: object) -> Any:
    """Check the value of a String or Binary: text, or the path or content of the file that it names."""
    if not isinstance(value, str):
        raise InputRefused(f'{where} = {value}: expected text, or "{FILE_PREFIX}NAME" for a file')
    path = FilePath(value.removeprefix(FILE_PREFIX))
    if path == value:
        return value if type_name == "String" else value.encode()
    if type_name == "Binary":
        return read_bytes(Path(path), MAX_BINARY_SIZE)
    if not os.path.isfile(path):
        raise InputRefused(f"{where}: {path}: no such file")
    return path


def given_values(value: ParameterValue, where: str) -> list[float] | list[str]:
    """Return the values of a parameter in an SSP parameter set, at least one."""
    if value.type == "Binary" or not value.values:
        what = "binary, which is not supported" if value.values else "given no value"
        raise InputRefused(f"{where}: {value.name} is {what}")
    if any(isinstance(one, str) and one.startswith(FILE_PREFIX) for one in value.values):
        raise InputRefused(
            f"{where}: {value.name} begins with '{FILE_PREFIX}'; a parameter set may not name files of this machine"
        )
    return list(value.values)  # type: ignore[return-value]


def defined_conversion(unit: str, definitions: Sequence[UnitDefinition]) -> Conversion | None:
    """Return the conversion of `unit` to SI by the definitions of an SSP file; None if it is not defined there."""
    for one in definitions:
        if one.name == unit:
            return si_conversion(unit, Conversion(one.dimension, one.factor, one.offset))
    return None


def stop_time(ticks: int | None, tick: float, substeps: int) -> float | None:
    """Compute the end of a run's last step (s): the duration, or t + h of that step as rounded, whichever is later."""
    if ticks is None:
        return None
    step = tick / substeps
    return max(ticks * tick, (ticks * substeps - 1) * step + step)
