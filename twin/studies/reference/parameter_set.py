"""Parameter files: System Structure Parameter Values (SSV) of the standard SSP 1.0 and 2.0, single values only.

https://ssp-standard.org/docs/2.0
"""

import math
from typing import NamedTuple

from twin.drive.description import FmuDescription
from twin.drive.units import conversion
from twin.errors import InputRefused, nearest
from twin.files import xml_of

MIME = "application/x-ssp-parameter-set"
WHOLE = {f"{sign}Int{bits}" for sign in ("", "U") for bits in (8, 16, 32, 64)} | {"Integer"}
REAL = {"Real", "Float64", "Float32"}
TRUTH = {"true": 1.0, "1": 1.0, "false": 0.0, "0": 0.0}
MOST_PARAMETERS = 100_000


class Value(NamedTuple):
    """Of a parameter; `unit` as the file states it, "" where it states none: the FMU's own."""

    value: float
    unit: str


def parameter_set(content: bytes, where: str) -> dict[str, Value]:
    """The values in an SSV file, by parameter.

    Raises:
        InputRefused: no SSV, a name that is given twice, or a value that is no single finite number or truth value.
    """
    root = xml_of(content, where)
    if _local(root.tag) != "ParameterSet":
        raise InputRefused(f"{where}: <{_local(root.tag)}>; expected <ParameterSet>, an SSV file")
    listed = [p for group in root if _local(group.tag) == "Parameters" for p in group if _local(p.tag) == "Parameter"]
    if len(listed) > MOST_PARAMETERS:
        raise InputRefused(f"{where}: {len(listed)} parameters; expected at most {MOST_PARAMETERS}")
    values: dict[str, Value] = {}
    for parameter in listed:
        name = parameter.get("name", "")
        kinds = [child for child in parameter if _local(child.tag) not in ("Annotations", "Dimension")]
        if not name or name in values or len(kinds) != 1:
            wrong = "without a name" if not name else "given twice" if name in values else "without one value"
            raise InputRefused(f"{where}: a parameter {wrong}{f', {name}' if name else ''}")
        (kind,) = kinds
        values[name] = Value(_number(kind.get("value", ""), _local(kind.tag), f"{where}: {name}"), kind.get("unit", ""))
    return values


def settings(values: dict[str, Value], description: FmuDescription, where: str) -> dict[str, float]:
    """`values` in the units of the FMU.

    Raises:
        InputRefused: a parameter the FMU has not, or cannot take, or in a unit that is not one of the same quantity.
    """
    set_: dict[str, float] = {}
    for name, (value, unit) in values.items():
        variable = description.variables.get(name)
        if variable is None:
            hint = nearest(name, description.variables, "it has no name like it")
            raise InputRefused(f"{where}: no parameter '{name}' in {description.path.name}; {hint}")
        if unit and unit != variable.unit:
            stated = conversion(unit, description.model.unitDefinitions)
            own = variable.conversion
            if stated is None or own is None or stated.dimension != own.dimension:
                raise InputRefused(
                    f"{where}: {name} in '{unit}'; expected '{variable.unit or '1'}', as in the FMU, or a unit like it"
                )
            value = (stated.factor * value + stated.offset - own.offset) / own.factor
        set_[name] = value
    try:
        description.settings(set_)
    except InputRefused as refusal:
        raise InputRefused(f"{where}: {str(refusal).removeprefix(f'{description.path}: ')}") from None
    return set_


def _number(text: str, kind: str, where: str) -> float:
    try:
        if kind == "Boolean":
            return TRUTH[text.strip()]
        value = float(int(text)) if kind in WHOLE else float(text) if kind in REAL else math.nan
    except (KeyError, ValueError, OverflowError):
        value = math.nan
    if not math.isfinite(value):
        raise InputRefused(f"{where}: {kind} '{text[:40]}'; expected one finite number, Real, Integer or Boolean")
    return value


def _local(tag: str) -> str:
    """A tag without its namespace, which has changed between versions."""
    return tag.rpartition("}")[2]
