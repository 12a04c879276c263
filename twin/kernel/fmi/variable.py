"""Variables of an FMU as in its model description: type, unit, enumeration."""

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
from twin.kernel.units import TEMPERATURE, Dimension, Unit, known_unit

NUMERIC_TYPES = (
    "Float64",
    "Float32",
    "Int8",
    "UInt8",
    "Int16",
    "UInt16",
    "Int32",
    "UInt32",
    "Int64",
    "UInt64",
    "Boolean",
)
"""The types of FMI 3.0 that hold numbers, by which a variable of any version is kept: its `kind` is the index."""

ITEM_SIZES = (8, 4, 1, 1, 2, 2, 4, 4, 8, 8, 1)
"""Bytes of one value of each of `NUMERIC_TYPES`."""

MAX_EXACT = 2**53
"""Largest integer below which a double represents every integer; signals are doubles."""
FLOAT_64, FLOAT_32 = float(np.finfo(np.float64).max), float(np.finfo(np.float32).max)
WHOLE_LOW = (-(2.0**7), 0.0, -(2.0**15), 0.0, -(2.0**31), 0.0, -(2.0**53), 0.0)
WHOLE_HIGH = (2.0**7 - 1, 2.0**8 - 1, 2.0**15 - 1, 2.0**16 - 1, 2.0**31 - 1, 2.0**32 - 1, 2.0**53, 2.0**53)
"""Bounds of the integer types of `NUMERIC_TYPES`, from the third on; for 64 bits, of the integers exact in a double."""
SPEED_DIMENSION = Dimension(s=-1)
RAD_PER_TURN = 2.0 * math.pi
UNIT_NAMES = (
    "1", "rad", "deg", "\N{DEGREE SIGN}", "rev", "rad/s", "deg/s", "rev/s", "rpm", "rev/min", "N.m", "N m", "Nm", "N*m",
    "mN.m", "mN m", "mNm", "mN*m", "N.cm", "A", "mA", "V", "mV", "W", "K",
)  # fmt: skip
"""As `twin.kernel.units` does."""
UNIT_ALIASES = {"": "1", "degree": "deg", "r": "rev", "turn": "rev", "r/s": "rev/s", "Ncm": "N.cm"}
ENERGY_UNITS = ("J", "kJ", "mJ", "Wh", "kWh")
"""In kg m2/s2 as torques are, and no torque."""
FMI1_KINDS = {"Real": "Float64", "Integer": "Int32", "Enumeration": "Int32"}
FMI2_KINDS = FMI1_KINDS | {"Boolean": "Int32"}
FMI3_KINDS = {"Enumeration": "Int64"}
"""How types travel, in words of FMI 3.0. Boolean is four bytes wide in FMI 2.0 and one in the others."""
TEXT_TYPES = ("String", "Binary")
"""Types whose values are no numbers."""
MAX_ARRAY_VALUES = 1_000_000
"""Of one array: no drive has more, and a file that says so would fill the memory."""
FILE_PREFIX = "file:"
"""Before the path of a file, for text that names one and for a Binary that holds what is in it."""
MAX_BINARY_SIZE = 64 << 20
"""Of a file that is handed over as a Binary."""


class Conversion(NamedTuple):
    """SI value = factor * value + offset, of a quantity of `dimension`."""

    dimension: Dimension
    factor: float = 1.0
    offset: float = 0.0


# SI Brochure, 2.3.4: hertz is for frequencies, what turns has rad/s; in hertz it counts turns, as per minute
UNIT_ALIASES |= {"Hz": "rev/s", "kHz": "rev/ms", "rps": "rev/s", "1/min": "rpm", "r/min": "rpm", "U/min": "rpm"}


def _without_radian(unit: Unit | None) -> Conversion:
    assert unit is not None
    return Conversion(unit.dimension._replace(rad=0), unit.scale)


KNOWN_UNITS = {name: _without_radian(known_unit(UNIT_ALIASES.get(name, name))) for name in (*UNIT_NAMES, *UNIT_ALIASES)}
KNOWN_UNITS |= dict.fromkeys(("degC", "\N{DEGREE SIGN}C"), Conversion(TEMPERATURE, 1.0, 273.15))
"""What a unit's name means where the FMU does not define it, or defines it in turns instead of radians."""


def conversion(unit: str, definitions: list[Any]) -> Conversion | None:
    """How values in `unit` become SI; None if neither the FMU's `definitions` (FMPy's) nor custom knows the unit."""
    for definition in definitions:
        if definition.name == unit and definition.baseUnit is not None:
            base = definition.baseUnit
            dimension = Dimension(*(int(getattr(base, name) or 0) for name in Dimension._fields))
            return si_conversion(unit, Conversion(dimension, float(base.factor), float(base.offset)))
    return si_conversion(unit)


def si_conversion(unit: str, stated: Conversion | None = None) -> Conversion | None:
    """How values in `unit` become SI, of which a file has `stated` so much; None if unknown.

    A definition as 1/s with the factor 1/60 (rpm as a frequency) or 1 (Hz) counts turns; the well-known name decides.
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


def parse_value(where: str, items: Mapping[str, float], value: float | str) -> float:
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


@dataclass(frozen=True)
class Variable:
    """A variable of an FMU.

    Attributes:
        name, causality, description: as the FMU has them.
        type: as the FMU has it, "Real" or "Float64".
        kind: index into `NUMERIC_TYPES`; -1: text or binary.
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
        return self.type in TEXT_TYPES

    @property
    def bounds(self) -> tuple[float, float]:
        """Smallest and largest value of its type; for 64-bit integers, of those exact in a double."""
        if self.type == "Boolean":
            return 0.0, 1.0
        if 2 <= self.kind < 10:
            return WHOLE_LOW[self.kind - 2], WHOLE_HIGH[self.kind - 2]
        most = FLOAT_32 if NUMERIC_TYPES[self.kind] == "Float32" else FLOAT_64
        return -most, most

    @property
    def range_phrase(self) -> str:
        """`which is UInt8 (0 .. 255)`."""
        low, high = self.bounds
        return f"which is {self.type} ({low:.17g} .. {high:.17g})"

    def range_error(self, value: float) -> str:
        """Why its type cannot hold `value`: `in8 is UInt8; expected 0 .. 255`; "" if it can."""
        low, high = self.bounds
        # an int is compared as it is, as a double may round it
        whole = self.type in REAL_TYPES or isinstance(value, int) or not abs(value) < MAX_EXACT // 2
        if low <= (value if whole else math.floor(value + 0.5)) <= high:
            return ""
        why = ", which doubles hold exactly" if self.kind in (8, 9) else ""
        return f"{self.name} is {self.type}; expected {low:.17g} .. {high:.17g}{why}"

    def format_value(self, value: float) -> str:
        """`value` for people: by its name, if it has one."""
        return next((name for name, number in self.items.items() if number == value), f"{value:g}")

    def with_size(self, file: Path, structure: Mapping[str, float]) -> "Variable":
        """The same variable where the structural parameters have the values of `structure`.

        Raises:
            InputRefused: it would have no values, or too many.
        """
        if not self.dimensions:
            return self
        sizes = [structure[d] if isinstance(d, str) else d for d in self.dimensions]
        size = math.prod(sizes)
        if not 1 <= size <= MAX_ARRAY_VALUES:
            asked = " x ".join(f"{s:g}" for s in sizes)
            raise InputRefused(f"{file}: '{self.name}' would have {asked} values; expected 1 .. {MAX_ARRAY_VALUES}")
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
    """Of an attribute; NaN if it is not stated or none."""
    if text in ("true", "false"):
        return float(text == "true")
    try:
        return float(text)
    except (TypeError, ValueError):
        return math.nan


class Setup(NamedTuple):
    """What an FMU is given of the run before it is initialised.

    Attributes:
        tolerance: relative, of its solver; None: nothing is said.
        stop: time of the last step's end (s); None: nothing is said, and some FMUs then end where they like to.
        step: length of its steps (s), in which its clocks tick; None: not known, and clocks are refused.
        ramped: whether those of its inputs that can be are given as lines over a step.
        waiting: whether it is left in initialisation mode, where what others come to can still be set, until `begin`.
        lenient: whether functions that it lacks are missed only when they are called.
        start: time of the first step's beginning (s), a whole number of steps.
    """

    tolerance: float | None = None
    stop: float | None = None
    step: float | None = None
    ramped: bool = False
    waiting: bool = False
    start: float = 0.0
    lenient: bool = False


Value = float | str | Sequence[float] | Sequence[str]
"""Of a parameter as an experiment says it: an array takes one value for all elements, or one for each."""

Setting = tuple[Variable, float | np.ndarray | list[str] | list[bytes]]
"""A variable and what to set it to, in its own unit; an array takes one value for all elements or one for each."""


class FilePath(str):
    """Text that is the path of a file."""


def to_json(value: float | np.ndarray | list[str] | list[bytes]) -> Any:
    """What a variable is set to, as JSON has it: a file or its content by SHA-256, and not by where it lies."""
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
    """`value` as `variable` of the FMU `file` takes it.

    Raises:
        InputRefused: it is of another type, out of range, none of an enumeration or not finite, there are too many
            or too few, no such file.
    """
    where = f"{file}: parameter {variable.name}"
    given: list[float | str] = list(value) if isinstance(value, Sequence) and not isinstance(value, str) else [value]
    if len(given) not in (1, variable.size):
        raise InputRefused(f"{where}: {len(given)} values; expected {variable.size}, or one for all of them")
    if variable.is_text:
        texts = [_text(where, text) for text in given] * (variable.size // len(given))
        if variable.type == "String":
            return [_path(where, text) for text in texts]
        return [_bytes(where, text) for text in texts]
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


def _text(where: str, value: object) -> str:
    if not isinstance(value, str):
        raise InputRefused(f'{where} = {value}: expected text, or "{FILE_PREFIX}NAME" for a file')
    return value


def _path(where: str, text: str) -> str:
    if not text.startswith(FILE_PREFIX):
        return text
    path = FilePath(text.removeprefix(FILE_PREFIX))
    if not os.path.isfile(path):
        raise InputRefused(f"{where}: {path}: no such file")
    return path


def _bytes(where: str, text: str) -> bytes:
    if not text.startswith(FILE_PREFIX):
        return text.encode()
    return read_bytes(Path(text.removeprefix(FILE_PREFIX)), MAX_BINARY_SIZE)


def given_values(value: ParameterValue, where: str) -> list[float] | list[str]:
    """What a parameter set gives, at least one value.

    Raises:
        InputRefused: it is binary, nothing, or text that names a file of this machine where an experiment says it.
    """
    if value.type == "Binary" or not value.values:
        what = "binary, which is not supported" if value.values else "given no value"
        raise InputRefused(f"{where}: {value.name} is {what}")
    if any(isinstance(one, str) and one.startswith(FILE_PREFIX) for one in value.values):
        raise InputRefused(
            f"{where}: {value.name} begins with '{FILE_PREFIX}'; a parameter set may not name files of this machine"
        )
    return list(value.values)  # type: ignore[return-value]


def defined_conversion(unit: str, definitions: Sequence[UnitDefinition]) -> Conversion | None:
    """How values in `unit` become SI by the `definitions` of an SSP file; None: it does not define that unit."""
    for one in definitions:
        if one.name == unit:
            return si_conversion(unit, Conversion(one.dimension, one.factor, one.offset))
    return None


def stop_time(ticks: int | None, tick: float, substeps: int) -> float | None:
    """When the last step ends (s): the run's duration, or what t + h of that step is rounded to, if that is later."""
    if ticks is None:
        return None
    step = tick / substeps
    return max(ticks * tick, (ticks * substeps - 1) * step + step)
