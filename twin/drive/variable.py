"""A variable of an FMU, as its model description has it."""

import math
from collections.abc import Mapping
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import Any

from twin.drive.enumeration import named_values
from twin.drive.kinds import KINDS
from twin.drive.units import Conversion, conversion
from twin.errors import InputRefused

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
        kind: index into `kinds.KINDS`; -1: text or binary.
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
