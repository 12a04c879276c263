"""A number with its interval."""

from typing import NamedTuple


class Estimate(NamedTuple):
    """value +- half_width, a 95 % interval, in the SI unit `unit`."""

    value: float
    half_width: float
    unit: str
