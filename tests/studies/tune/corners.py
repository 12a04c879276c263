"""Corners of Fig. 4's experiment, made once."""

from functools import cache

from tests.laws.runs import shipped
from twin.studies.tune.prediction import Corner, corners

STIFFNESS = (300.0, 5000.0)


@cache
def fig4_corners() -> tuple[Corner, ...]:
    """In air, and pressing on three stiffnesses at both ends of the sweep."""
    return tuple(corners([shipped()], STIFFNESS)[0])
