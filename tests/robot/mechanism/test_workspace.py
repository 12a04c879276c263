import numpy as np
import pytest
from hypothesis import assume, given
from hypothesis import strategies as st
from scipy.optimize import brentq

from tests.robot.mechanism.poses import GEOMETRY, HOME, TURN, height_range, reach_margins
from twin.robot.mechanism.kinematics import jacobian, joint_angles, loop_coefficients, position
from twin.robot.mechanism.unreachable import Unreachable
from twin.robot.mechanism.workspace import is_reachable

anywhere = st.tuples(st.floats(-0.15, 0.15), st.floats(-0.15, 0.15), st.floats(-0.2, -1e-3)).map(np.array)


def smallest_margin(z, x, y):
    return reach_margins(GEOMETRY, (x, y, z)).min()


def test_reach_on_the_axis_runs_from_172_7_to_50_1_mm_below_the_base():
    # the reference values are given to 0.1 mm
    np.testing.assert_allclose(height_range(GEOMETRY, 0.0, 0.0), (-0.1727, -0.0501), rtol=0, atol=5e-5)


@given(st.floats(-0.04, 0.04), st.floats(-0.04, 0.04))
def test_height_range_ends_where_the_search_finds_the_last_reachable_height(x, y):
    lowest, highest = height_range(GEOMETRY, x, y)
    # 1e-12 m: the search's own tolerance
    assert lowest == pytest.approx(brentq(smallest_margin, -0.25, -0.1, (x, y), xtol=1e-13), abs=1e-12)
    assume(smallest_margin(-1e-6, x, y) < 0.0)
    assert highest == pytest.approx(brentq(smallest_margin, -0.1, -1e-6, (x, y), xtol=1e-13), abs=1e-12)


def test_a_pose_beyond_the_parallel_singularity_is_not_reachable_although_all_legs_reach():
    p_B = (-0.0025, -0.1176, -0.0504)
    assert reach_margins(GEOMETRY, p_B).min() > 0.005
    assert not is_reachable(GEOMETRY, p_B)


@given(st.floats(-0.3, 0.3), st.floats(-0.3, 0.3), st.floats(-0.3, -1e-3))
def test_heights_outside_the_range_are_out_of_reach(x, y, z):
    lowest, highest = height_range(GEOMETRY, x, y)
    # 1e-12 m on either side of the edges: rounding
    assume(min(abs(z - lowest), abs(z - highest)) > 1e-12)
    assert (smallest_margin(z, x, y) > 0.0) == (lowest < z < highest)


@given(anywhere, st.sampled_from([0, 1, 2]))
def test_reach_margin_has_the_sign_of_the_discriminant(p_B, leg):
    E, F, G = loop_coefficients(GEOMETRY, leg, *p_B)
    margin = reach_margins(GEOMETRY, p_B)[leg]
    assume(abs(margin) > 1e-12)  # rounding decides the sign closer to the edge
    assert (margin > 0.0) == (E**2 + F**2 > G**2)


@given(anywhere)
def test_a_reachable_pose_is_where_the_robot_stands_at_its_own_joint_angles(p_B):
    try:
        again = position(GEOMETRY, joint_angles(GEOMETRY, p_B))
        # 1e-6 m: poses beyond the parallel singularity come back far from where they were
        stands = bool(np.abs(again - p_B).max() < 1e-6)
    except Unreachable:
        stands = False
    assert is_reachable(GEOMETRY, p_B) == stands


@given(anywhere)
def test_turning_a_pose_by_120_degrees_passes_the_margins_to_the_next_leg(p_B):
    # 1e-15 m: rounding of the turned pose
    np.testing.assert_allclose(
        reach_margins(GEOMETRY, TURN @ p_B), np.roll(reach_margins(GEOMETRY, p_B), 1), rtol=0, atol=1e-15
    )


def test_a_batch_equals_its_single_poses():
    p_B = np.random.default_rng(5).uniform([-0.15, -0.15, -0.2], [0.15, 0.15, 0.0], (40, 5, 3))
    reachable = is_reachable(GEOMETRY, p_B)
    assert 0 < reachable.sum() < reachable.size
    np.testing.assert_array_equal(reachable, [[is_reachable(GEOMETRY, p) for p in row] for row in p_B])
    margins = reach_margins(GEOMETRY, p_B)
    np.testing.assert_array_equal(margins, [[reach_margins(GEOMETRY, p) for p in row] for row in p_B])


def test_the_task_of_figure_4_is_conditioned_between_1_44_and_1_67():
    y, z = np.meshgrid(np.linspace(-0.020, 0.020, 41), np.linspace(-0.105, -0.085, 21))
    numbers = np.linalg.cond(jacobian(GEOMETRY, np.stack([np.zeros_like(y), y, z], axis=-1)))
    # the reference values are given to 0.01
    assert numbers.min() == pytest.approx(1.44, abs=0.005)
    assert numbers.max() == pytest.approx(1.67, abs=0.005)


def test_the_working_range_is_conditioned_below_2_54():
    axes = np.linspace(-0.030, 0.030, 13), np.linspace(-0.030, 0.030, 13), np.linspace(-0.130, -0.085, 10)
    numbers = np.linalg.cond(jacobian(GEOMETRY, np.stack(np.meshgrid(*axes), axis=-1)))
    # the reference value is given to 0.01
    assert numbers.max() == pytest.approx(2.54, abs=0.005)


def test_home_is_reachable():
    assert is_reachable(GEOMETRY, HOME)
