"""Names and numbers of a sweep as they are shown."""

import math
from collections.abc import Sequence

from twin.studies.sweep.columns import Column


def short(labels: Sequence[str]) -> dict[str, str]:
    """Each label by as few of its last parts as tell it from the others; a number never stands alone."""
    names = {}
    for label in labels:
        parts = label.split(".")
        for count in range(2 if parts[-1].isdigit() else 1, len(parts) + 1):
            name = ".".join(parts[-count:])
            if sum(other == name or other.endswith(f".{name}") for other in labels) == 1:
                break
        names[label] = name
    return names


def number(value: float) -> str:
    """With four digits; `-` if there is none, `never` for infinity."""
    if math.isnan(value):
        return "-"
    if math.isinf(value):
        return "never"
    return "0" if abs(value) < 1e-12 else f"{value:.4g}"


def interval(ends: tuple[float, float], form: str = ".2f") -> str:
    """`0.12 .. 0.34`; `-` if there is none."""
    low, high = ends
    return "-" if math.isnan(low) or math.isnan(high) else f"{low:{form}} .. {high:{form}}"


def shown(parameters: Column | None, row: int) -> str:
    """The value of a parameter in a row; `-` if the run does not have it."""
    parameter = None if parameters is None else parameters[row]
    if parameter is None or parameter != parameter:
        return "-"
    return f"{parameter:.4g}" if isinstance(parameter, float) else str(parameter)
