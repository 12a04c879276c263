import math

import numpy as np
import pytest
from hypothesis import given

from tests.robot.mechanism.poses import GEOMETRY, HOME, height_range, reachable_poses
from twin.robot.mechanism.kinematics import (
    SingularPose,
    distal_volume,
    jacobian,
    joint_angles,
    loop_coefficients,
    refuse_parallel_singularity,
    refuse_serial_singularity,
    transmission_sines,
)


@given(reachable_poses())
def test_determinant_of_the_inverse_is_made_of_both_measures(p_B):
    J = jacobian(GEOMETRY, p_B)
    product = GEOMETRY.l_a**3 * transmission_sines(GEOMETRY, J).prod() / distal_volume(J)
    # 1e-9: the inverse of a matrix with condition up to 1e6 at the drawn edges
    assert np.linalg.det(np.linalg.inv(J)) == pytest.approx(product, rel=1e-9)


@given(reachable_poses())
def test_transmission_sines_are_the_root_of_the_discriminant(p_B):
    sines = transmission_sines(GEOMETRY, jacobian(GEOMETRY, p_B))
    for leg in range(3):
        E, F, G = loop_coefficients(GEOMETRY, leg, *p_B)
        # compared squared: D = 0 at the edge carries an absolute error of 1e-16 (l_a l_b)^2
        D = (2.0 * GEOMETRY.l_a * GEOMETRY.l_b * sines[leg]) ** 2
        assert pytest.approx(E**2 + F**2 - G**2, rel=1e-9, abs=1e-17) == D


def test_a_leg_in_its_own_plane_has_the_sine_of_the_angle_between_its_links():
    theta = joint_angles(GEOMETRY, HOME)[0]
    u = -(GEOMETRY.a - GEOMETRY.b)
    distal = math.atan2(-HOME[2] - GEOMETRY.l_a * math.sin(theta), u - GEOMETRY.l_a * math.cos(theta))
    sine = transmission_sines(GEOMETRY, jacobian(GEOMETRY, HOME))[0]
    # 1e-14: rounding of angles
    assert sine == pytest.approx(math.sin(distal - theta), abs=1e-14)


def test_transmission_dies_towards_both_ends_of_the_axis():
    lowest, highest = height_range(GEOMETRY, 0.0, 0.0)
    ends = [(0.0, 0.0, lowest + 1e-9), HOME, (0.0, 0.0, highest - 1e-9)]
    low, home, high = transmission_sines(GEOMETRY, jacobian(GEOMETRY, ends)).min(axis=-1)
    # 1e-9 m inside the edge the sine is of order sqrt(1e-9 m / 0.1 m) = 1e-4
    assert low < 1e-3 < 0.9 < home
    assert high < 1e-3


def platform_in_the_plane_of_its_distal_links():
    """A robot and a pose whose distal links all lie horizontal: the arms' ends as far apart as they reach."""
    theta = 0.35
    l_b = GEOMETRY.a - GEOMETRY.b + GEOMETRY.l_a * math.cos(theta)
    return GEOMETRY._replace(l_b=l_b), np.array([0.0, 0.0, -GEOMETRY.l_a * math.sin(theta)])


def test_distal_links_in_one_plane_span_no_volume():
    geometry, p_B = platform_in_the_plane_of_its_distal_links()
    # 1e-14: rounding of unit vectors
    assert distal_volume(jacobian(geometry, p_B)) == pytest.approx(0.0, abs=1e-14)


def test_distal_volume_changes_sign_with_the_side_of_the_plane():
    geometry, p_B = platform_in_the_plane_of_its_distal_links()
    # 1 um to either side, with distal links of the length that fits
    for side, sign in ((-1e-6, -1.0), (1e-6, 1.0)):
        longer = geometry._replace(l_b=math.hypot(geometry.l_b, side))
        assert np.sign(distal_volume(jacobian(longer, p_B + np.array([0.0, 0.0, side])))) == sign


def test_parallel_singularity_is_refused_without_blaming_a_leg():
    geometry, p_B = platform_in_the_plane_of_its_distal_links()
    with pytest.raises(SingularPose, match=r"\(0\.0, 0\.0, -20\.6\) mm is singular: .* one plane") as refused:
        refuse_parallel_singularity(jacobian(geometry, p_B), p_B)
    assert refused.value.leg == 0


def test_an_infinite_or_undefined_row_is_a_serial_singularity():
    p_B = np.array(HOME)
    for value in (math.inf, math.nan):
        J = jacobian(GEOMETRY, HOME)
        J[1] = value
        with pytest.raises(SingularPose, match="leg 2 is stretched or folded"):
            refuse_serial_singularity(GEOMETRY, J, p_B)


def test_the_smallest_measure_known_not_to_be_zero_is_none():
    # of a leg of 1 m the measure is 1 over the length of its row: here 1e-7, and just below it
    geometry, edge = GEOMETRY._replace(l_a=1.0), 1e7 * np.eye(3)
    refuse_serial_singularity(geometry, edge, np.array(HOME))
    with pytest.raises(SingularPose, match="leg 1 is stretched or folded"):
        refuse_serial_singularity(geometry, 1.000001 * edge, np.array(HOME))


def test_the_home_pose_is_not_singular():
    J = jacobian(GEOMETRY, HOME)
    refuse_serial_singularity(GEOMETRY, J, np.array(HOME))
    refuse_parallel_singularity(J, np.array(HOME))
