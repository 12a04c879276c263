"""A variable of an FMU, as its model description has it."""

import math
from dataclasses import dataclass
from typing import Any

from twin.drive.adapter import KINDS
from twin.drive.units import Conversion, conversion

FMI2_KINDS = {"Real": "Float64", "Integer": "Int32", "Boolean": "Int32", "Enumeration": "Int32"}
FMI3_KINDS = {"Enumeration": "Int64"}
"""How types travel that have no functions of their own, in words of FMI 3.0."""


@dataclass(frozen=True)
class Variable:
    """A variable of an FMU.

    Attributes:
        name, causality, description: as the FMU has them.
        type: as the FMU has it, "Real" or "Float64".
        kind: index into `adapter.KINDS`; -1: text or binary.
        reference: FMI value reference.
        size: number of values, > 1 for an array.
        unit: as the FMU has it, "" where it states none.
        conversion: to SI; None: unit unknown or not stated.
        start, low, high: as the FMU has them, in its own unit; NaN: not stated.
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


def variable_of(v: Any, model: Any) -> Variable:
    declared = v.declaredType
    unit = v.unit or (declared.unit if declared is not None else None) or ""
    # Boolean is a type of both standards, four bytes wide in the one and one in the other
    kind = (FMI2_KINDS if model.fmiVersion == "2.0" else FMI3_KINDS).get(v.type, v.type)
    size = 1
    for dimension in v.dimensions or ():
        size *= int(dimension.start) if dimension.start is not None else int(dimension.variable.start)
    return Variable(
        name=v.name,
        causality=v.causality or "local",
        description=v.description or "",
        type=v.type,
        kind=KINDS.index(kind) if kind in KINDS else -1,
        reference=v.valueReference,
        size=size,
        unit=unit,
        conversion=conversion(unit, model.unitDefinitions) if unit else None,
        start=number(v.start),
        low=number(v.min),
        high=number(v.max),
    )


def number(text: Any) -> float:
    if text in ("true", "false"):
        return float(text == "true")
    try:
        return float(text)
    except (TypeError, ValueError):
        return math.nan
