"""Values that have names, as the FMU's type definitions say."""

from collections.abc import Mapping
from contextlib import suppress
from typing import Any

from twin.errors import InputRefused, nearest


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
