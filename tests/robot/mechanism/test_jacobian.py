import numpy as np
import pytest
from hypothesis import given

from tests.robot.mechanism.poses import GEOMETRY, HOME, TURN, reachable_poses, triple, working_poses
from twin.robot.mechanism.geometry import Geometry
from twin.robot.mechanism.kinematics import SingularPose, jacobian, joint_angles, loop_coefficients
from twin.robot.mechanism.unreachable import Unreachable

STEP = 1e-30  # of the complex-step derivative: no subtraction, so no cancellation however small


def complex_joint_angles(p_B):
    """Eq. 11 and 12 with the knee outward, for complex positions."""
    E, F, G = np.transpose([loop_coefficients(GEOMETRY, leg, *p_B) for leg in range(3)])
    return 2.0 * np.arctan((G + E) / (np.sqrt(E**2 + F**2 - G**2) - F))


@given(working_poses, triple)
def test_jacobian_is_the_derivative_of_the_joint_angles(p_B, v):
    derivative = complex_joint_angles(p_B + 1j * STEP * v).imag / STEP
    # 1e-13 relative to |J| = 20 rad/m: two evaluations of different formulas
    np.testing.assert_allclose(jacobian(GEOMETRY, p_B) @ v, derivative, rtol=0, atol=2e-12)


@given(reachable_poses(), triple)
def test_joint_speeds_follow_central_differences_in_the_whole_workspace(p_B, v):
    step = 1e-7
    try:
        ahead, behind = joint_angles(GEOMETRY, [p_B + step * v, p_B - step * v])
    except Unreachable:
        return
    J = jacobian(GEOMETRY, p_B)
    # truncation grows with the curvature |J|^3 step^2, cancellation is 1e-15/step; constants found generous
    tolerance = 1e-7 + 1e-13 * float(np.linalg.norm(J)) ** 4
    np.testing.assert_allclose(J @ v, (ahead - behind) / (2.0 * step), rtol=0, atol=tolerance)


@given(working_poses)
def test_turning_the_platform_by_120_degrees_turns_the_rows_and_passes_them_on(p_B):
    # 1e-12: rounding of the turned pose times |J|^2
    np.testing.assert_allclose(
        jacobian(GEOMETRY, TURN @ p_B),
        np.roll(jacobian(GEOMETRY, p_B), 1, axis=0) @ TURN.T,
        rtol=0,
        atol=1e-12,
    )


def test_spring_stiffness_at_home_is_874_874_and_2137_newton_per_metre():
    k_s, N = 1.0, 2.0
    J = jacobian(GEOMETRY, HOME)
    # the reference values are given in whole N/m
    np.testing.assert_allclose(k_s * N**2 * J.T @ J, np.diag([873.5, 873.5, 2137.4]), rtol=0, atol=0.5)


def test_a_batch_equals_its_single_poses():
    p_B = np.random.default_rng(3).uniform([-0.03, -0.03, -0.13], [0.03, 0.03, -0.085], (4, 5, 3))
    batch = jacobian(GEOMETRY, p_B)
    assert batch.shape == (4, 5, 3, 3)
    np.testing.assert_array_equal(batch, [[jacobian(GEOMETRY, p) for p in row] for row in p_B])


def test_a_stretched_leg_is_refused_by_name():
    # u, z and l_a + l_b in the ratio 3 : 4 : 5, in binary fractions: D = 0 without rounding
    geometry = Geometry(a=4 / 32, b=1 / 32, l_a=2 / 32, l_b=3 / 32)
    stretched = (0.0, 0.0, -4 / 32)
    with pytest.raises(SingularPose, match=r"p_B\[1\] = .*, -125\.0\) mm is singular: leg 1 is") as refused:
        jacobian(geometry, [(0.0, 0.0, -3 / 32), stretched])
    assert refused.value.leg == 1
    assert refused.value.pose == stretched
