"""Corners of Fig. 4's experiment, made once."""

from functools import cache

from tests.laws.runs import shipped
from twin.studies.tune.prediction import Corner, LawGains, StepAnswer, corners, predict

STIFFNESS = (300.0, 5000.0)


@cache
def fig4_corners() -> tuple[Corner, ...]:
    """In air, and pressing on three stiffnesses at both ends of the sweep."""
    return tuple(corners([shipped()], STIFFNESS)[0])


def predicted(corner: Corner, gains: LawGains) -> StepAnswer:
    """The step response of gains that are stable."""
    answer = predict(corner, gains).answer
    assert answer is not None
    return answer
