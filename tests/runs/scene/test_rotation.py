"""The quaternions against scipy's rotations."""

import math

import numpy as np
from hypothesis import given
from hypothesis import strategies as st
from scipy.spatial.transform import Rotation

from tests.robot.poses import triple
from twin.runs.scene.rotation import IDENTITY, pointing, product, turn

# rounding of a dozen operations on numbers up to 1
ROUNDING = 1e-14
angles = st.floats(-math.pi, math.pi)
axes = st.sampled_from([0, 1, 2])


@given(axes, angles)
def test_a_turn_is_right_handed_about_its_axis(axis, angle):
    expected = Rotation.from_euler("xyz"[axis], angle).as_matrix()
    np.testing.assert_allclose(Rotation.from_quat(turn(axis, angle)).as_matrix(), expected, atol=ROUNDING)


@given(axes, angles, axes, angles)
def test_a_product_turns_by_its_second_factor_first(axis, angle, other_axis, other_angle):
    p, q = turn(axis, angle), turn(other_axis, other_angle)
    expected = Rotation.from_quat(p) * Rotation.from_quat(q)
    found = Rotation.from_quat(product(p, q))
    np.testing.assert_allclose(found.as_matrix(), expected.as_matrix(), atol=ROUNDING)


@given(triple.filter(lambda v: np.linalg.norm(v) > 0))
def test_a_pointing_turn_takes_e_x_to_the_direction_of_its_vector(v):
    found = Rotation.from_quat(pointing(*v)).apply([1.0, 0.0, 0.0])
    np.testing.assert_allclose(found, v / np.linalg.norm(v), atol=ROUNDING)


def test_nothing_points_nowhere_without_a_turn():
    assert np.array_equal(pointing(0.0, 0.0, 0.0), IDENTITY)
