"""A number with its interval, and in which unit and with how many digits it is read."""

from math import degrees, floor, log10
from typing import NamedTuple

DISPLAY_UNITS = {"rad": (degrees(1.0), "deg"), "m": (1e3, "mm"), "s": (1e3, "ms"), "1": (1.0, "")}


class Estimate(NamedTuple):
    """value +- half_width, a 95 % interval, in the SI unit `unit`."""

    value: float
    half_width: float
    unit: str


def display_value(value: float, unit: str) -> float:
    """`value` (SI) in the unit that people read."""
    return value * DISPLAY_UNITS.get(unit, (1.0, unit))[0]


def display_unit(unit: str) -> str:
    """The unit that people read."""
    return DISPLAY_UNITS.get(unit, (1.0, unit))[1]


def decimals(estimate: Estimate) -> int:
    """Digits after the point that an interval with two significant digits needs."""
    width = display_value(estimate.half_width, estimate.unit)
    return 0 if not 0.0 < width < 1e6 else min(max(1 - floor(log10(width)), 0), 6)
