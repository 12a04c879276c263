""" """

import numpy as np
import pytest

from tests.laws.runs import PARAMETERS, shipped
from tests.studies.analyse.simulated import fig4
from twin.kernel.errors import InputRefused
from twin.robot.assembly.drives import plan_drive
from twin.robot.experiment.drive_files import load_drive
from twin.robot.plant.dynamics import derivative
from twin.studies.analyse.drive_response import identify_drive, sum_of_sines
from twin.studies.analyse.nudge import ResidualSwing, residual_swings, swing
from twin.studies.analyse.operating_point import (
    AIR_CLEARANCE,
    operating_points,
    point_on_stiffness,
    pressing_height,
    resting_point,
    surface_height,
)

NUDGE = 1e-4


@pytest.mark.parametrize(
    ("hum", "left", "lasts"),
    [
        (0.0, 0.39e-4, False),
        (0.0, 0.41e-4, True),
        # a drive that hums by 0.2 mm may go on with it, and with a little more
        (2e-4, 5e-4, False),
        (2e-4, 7e-4, True),
        # nothing that swings by more than a millimetre is a hum
        (5e-3, 2e-3, True),
        (0.0, np.inf, True),
    ],
)
def test_a_nudge_lasts_if_much_of_it_is_left_that_was_no_hum(hum, left, lasts):
    assert ResidualSwing(hum, left).lasts(NUDGE) == lasts


def test_a_swing_is_told_without_the_creeping_below_it():
    t = np.linspace(0.0, 1.0, 1001)
    p_B = np.stack([0.1 * t, 2e-4 * np.sin(20.0 * np.pi * t) + 0.3 * t, 0.2 - 0.1 * t], axis=1)
    # ten whole swings tilt the line by a twelfth of themselves
    assert swing(p_B) == pytest.approx(4e-4, rel=0.1)


def test_a_run_that_fails_or_goes_far_off_leaves_a_lasting_swing():
    experiment = fig4(())
    air = operating_points(experiment)[0][1]
    assert residual_swings(experiment, air, "position", 40.0, [NUDGE]) == [ResidualSwing(0.0, np.inf)]
    (still,) = residual_swings(experiment, air, "position", 1.0, [NUDGE])
    # nothing hums in the default drive, and a tenth of the limit lets a nudge die out at once
    assert still.before < 0.1 * NUDGE and still.after < 0.1 * NUDGE


def test_fig4_is_looked_at_at_its_start_and_at_both_ends_of_its_line():
    points, problems = operating_points(shipped())
    assert problems == []
    assert [(point.p_B[1], round(point.F_z, 9), point.force_on) for point in points] == [
        (0.02, 0.0, False),
        (0.02, 0.0, False),
        (0.02, 5.0, True),
        (-0.02, 0.0, False),
        (-0.02, 5.0, True),
    ]


@pytest.mark.slow
@pytest.mark.parametrize("name", ["fig4_force_position", "fig4_imperfect", "massage"])
def test_nothing_moves_at_an_operating_point(name):
    for point in operating_points(shipped(name))[0]:
        dx = np.empty(8)
        derivative(point.parameters, point.x, point.theta_m, (0.0,) * 3, (0.0,) * 3, dx)
        # accelerations, of which gravity is 9.81: rounding of one linear solve
        assert np.abs(dx).max() < 1e-9


def test_in_a_tap_the_force_loop_is_off():
    points = operating_points(shipped("tapping"))[0]
    assert [point.force_on for point in points if point.in_contact] == [False]


def test_a_tilted_surface_is_found_where_it_is():
    tilted = PARAMETERS._replace(tilt=0.1)
    # one root-finding to 1e-12 m
    assert surface_height(tilted, 0.02, 0.0) == pytest.approx(PARAMETERS.z_s - 0.02 * np.tan(0.1), abs=1e-11)
    z = pressing_height(tilted, 0.02, 0.0, 5.0)
    assert resting_point("pressing", tilted, (0.02, 0.0, z)).F_z == pytest.approx(5.0, abs=1e-8)


def test_above_is_one_millimetre_over_the_surface():
    above = operating_points(shipped())[0][1]
    assert above.p_B[2] == pytest.approx(PARAMETERS.z_s + AIR_CLEARANCE, abs=1e-11)


@pytest.mark.parametrize("K", [100.0, 1250.0, 50_000.0])
def test_on_another_stiffness_pose_and_force_stay(K):
    point = operating_points(shipped())[0][2]
    moved = point_on_stiffness(point, K)
    assert moved.p_B == point.p_B
    assert moved.F_z == pytest.approx(point.F_z, abs=1e-6)
    # the force is K times the depth
    depth = surface_height(moved.parameters, *point.p_B[:2]) - point.p_B[2]
    assert depth == pytest.approx(point.F_z / K, rel=1e-6)


def test_a_slack_spring_has_no_linear_model():
    weightless = PARAMETERS._replace(m_a=0.0, m_b=0.0, m_p=0.0)
    with pytest.raises(InputRefused, match=r"no linear model at \(0, 0, -90\) mm: the spring of leg 1 carries nothing"):
        resting_point("start", weightless, (0.0, 0.0, -0.09))
    # without backlash there is nothing to hang in
    resting_point("start", weightless._replace(backlash=0.0), (0.0, 0.0, -0.09))


def test_a_pose_out_of_reach_has_no_operating_point():
    with pytest.raises(InputRefused, match=r"no operating point at \(0, 0, -300\) mm"):
        resting_point("start", PARAMETERS, (0.0, 0.0, -0.3))


def test_a_surface_that_is_too_soft_is_left_out_with_its_reason():
    points, problems = operating_points(shipped("fig4_force_position", "contact.stiffness_N_per_m=20"))
    assert len(points) == 3
    assert len(problems) == 2 and "does not reach 5 N within 100 mm of depth" in problems[0]


TICK = 1e-3


def test_the_default_drive_is_its_own_equation(root):
    drive = identify_drive(plan_drive(load_drive("velocity_servo", root)), TICK, 0.05)
    # T_m d omega / dt = omega_ref - droop tau_load - omega, solved exactly over a tick with inputs held
    assert drive.A == pytest.approx(np.array([[np.exp(-TICK / 0.02)]]), rel=1e-9)
    # advance per tick of a speed command, and of a load with a droop of 0.6 rad/s per N m; a fit by least squares
    np.testing.assert_allclose(drive.steady_gain, [TICK, -0.6 * TICK], rtol=1e-9)


@pytest.mark.parametrize("name", ["brushed_dc", "pmsm_foc", "torque_motor_fmi3"])
def test_drives_of_other_kinds_follow_their_command_at_rest(root, name):
    drive = identify_drive(plan_drive(load_drive(name, root)), TICK, 0.05)
    # 5 %: ripple and friction of the nonlinear ones
    np.testing.assert_allclose(drive.steady_gain, [TICK, 0.0], atol=0.05 * TICK)


def test_the_same_drive_gives_the_same_model_twice(root):
    plan = plan_drive(load_drive("pmsm_foc", root))
    one, two = identify_drive(plan, TICK, 0.05), identify_drive(plan, TICK, 0.05)
    np.testing.assert_array_equal(one.A, two.A)
    np.testing.assert_array_equal(one.B, two.B)


def test_a_sum_of_sines_has_its_lines_and_nothing_else():
    lines = np.array([1, 4, 9])
    wave = sum_of_sines(1000, lines, np.array([0.3, 2.0, 5.0]))
    spectrum = np.abs(np.fft.rfft(wave))
    # powers fall as 1/f; a transform's rounding
    np.testing.assert_allclose(spectrum[lines] / spectrum[1], 1.0 / np.sqrt(lines), rtol=1e-9)
    assert np.delete(spectrum, lines).max() < 1e-9 * spectrum[1]
    assert np.max(np.abs(wave)) == pytest.approx(1.0)


@pytest.mark.parametrize("name", ["smart_servo", "xl330"])
def test_a_drive_that_swallows_small_signals_is_measured_while_it_turns(root, name):
    """Registers do so, and friction that sticks."""
    assert identify_drive(plan_drive(load_drive(name, root)), TICK, -0.002).turning


def test_a_drive_that_answers_small_signals_is_measured_at_rest(root):
    assert not identify_drive(plan_drive(load_drive("velocity_servo", root)), TICK, 0.05).turning
