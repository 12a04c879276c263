"""A delta that is a little another one exceeds the bounds of what is printed or known of it."""

import numpy as np
import pytest

from twin.robot.mechanism.geometry import Geometry
from twin.robot.mechanism.kinematics import joint_angles, position
from twin.robot.mechanism.unreachable import Unreachable
from validation.engine.constrained import Numbers
from validation.yardsticks import flexpicker, visual_kinematics
from validation.yardsticks.flexpicker import FLEXPICKER
from validation.yardsticks.visual_kinematics import (
    ANGLES,
    BOUNDS,
    CONDITION,
    EDGE,
    LENGTHS,
    POSES,
    SINGULAR,
    compared,
    to_singularity,
)


@pytest.mark.parametrize("name", FLEXPICKER._fields)
def test_a_length_that_is_off_by_a_tenth_of_a_millimetre_exceeds_what_is_printed(name: str):
    other = FLEXPICKER._replace(**{name: getattr(FLEXPICKER, name) + 1e-4})
    of_places, of_angles = flexpicker.YARDSTICKS
    assert max(flexpicker.places(other).values()) > of_places.bound
    assert max(flexpicker.angles(other).values()) > of_angles.bound


class Delta:
    """A library for a delta of other lengths, with what it gets wrong."""

    def __init__(self, geometry: Geometry, off: float = 0.0):
        self._geometry, self._off = geometry, off

    def place(self, theta: Numbers) -> Numbers:
        try:
            return position(self._geometry, theta) + self._off * np.sin(50.0 * theta)
        except Unreachable:
            return np.full(3, np.nan)

    def angles(self, p_B: Numbers) -> Numbers:
        try:
            return joint_angles(self._geometry, p_B)
        except Unreachable:
            return np.zeros(3)


@pytest.fixture
def few(monkeypatch: pytest.MonkeyPatch):
    monkeypatch.setattr(visual_kinematics, "POINTS", 300)
    monkeypatch.setattr(visual_kinematics, "RAYS", 5)


def exceeded(geometry: Geometry, off: float = 0.0) -> set[str]:
    found = compared(Delta(geometry, off))
    return {key for key in found if not found[key] <= BOUNDS[key]}


@pytest.mark.usefixtures("few")
def test_the_same_delta_exceeds_nothing():
    assert exceeded(LENGTHS) == set()


def test_where_a_library_reaches_farther_than_the_twin_there_is_no_singularity_of_the_twin():
    assert to_singularity(np.array([0.0, 0.0, -0.9])) == np.inf


@pytest.mark.usefixtures("few")
def test_another_delta_exceeds_all_bounds():
    other = LENGTHS._replace(l_b=LENGTHS.l_b - 0.01)
    assert exceeded(other) == {POSES, ANGLES, CONDITION, EDGE, SINGULAR}


@pytest.mark.usefixtures("few")
@pytest.mark.parametrize("name", LENGTHS._fields)
def test_a_length_that_is_off_by_ten_micrometres_is_noticed(name: str):
    other = LENGTHS._replace(**{name: getattr(LENGTHS, name) + 1e-5})
    assert {ANGLES, CONDITION, EDGE} <= exceeded(other)


@pytest.mark.usefixtures("few")
def test_a_ripple_of_a_thousandth_of_a_micrometre_is_seen_in_the_condition_number():
    assert exceeded(LENGTHS, 1e-9) == {CONDITION}
