"""Estimate of a quantity with its interval, its display unit and number of digits."""

from math import degrees, floor, log10
from typing import NamedTuple

DISPLAY_UNITS = {"rad": (degrees(1.0), "deg"), "m": (1e3, "mm"), "s": (1e3, "ms"), "1": (1.0, "")}


class Estimate(NamedTuple):
    """Estimate of a quantity with its 95 % interval, value +- half_width, in the SI unit `unit`."""

    value: float
    half_width: float
    unit: str


def display_value(value: float, unit: str) -> float:
    return value * DISPLAY_UNITS.get(unit, (1.0, unit))[0]


def display_unit(unit: str) -> str:
    return DISPLAY_UNITS.get(unit, (1.0, unit))[1]


def decimals(estimate: Estimate) -> int:
    """Compute the number of decimals to print an estimate: its interval has two significant digits."""
    width = display_value(estimate.half_width, estimate.unit)
    return 0 if not 0.0 < width < 1e6 else min(max(1 - floor(log10(width)), 0), 6)
