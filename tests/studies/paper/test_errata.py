"""Every row of docs/paper.md: the printed equation fails where the corrected one holds."""

import math

import numpy as np
import pytest
from scipy.optimize import brentq

from tests.robot.mechanism.poses import GEOMETRY, HOME, MASSES
from twin.robot.mechanism.geometry import LEG_COS, LEG_SIN, distal_link
from twin.robot.mechanism.kinematics import (
    jacobian,
    joint_angles,
    leg_angle,
    loop_coefficients,
    position,
    sphere_centre,
)
from twin.robot.mechanism.statics import (
    directed_load_torque,
    end_effector_force,
    environment_force,
    joint_torques,
    load_torque,
)

OFF_HOME = (0.012, -0.017, -0.104)
START = (0.0, 0.020, -0.085)


def rotation(degrees):
    c, s = math.cos(math.radians(degrees)), math.sin(math.radians(degrees))
    return np.array([[c, -s, 0.0], [s, c, 0.0], [0.0, 0.0, 1.0]])


# Eq. 5 and 6


def printed_distal_link_of_leg_3(theta_3, p_B, phi_3):
    a, b, l_a, _ = GEOMETRY
    m, n = math.sqrt(3) / 2 * (b - a), (b - a) / 2
    return np.array(
        [
            p_B[0] + l_a * math.cos(theta_3) * math.cos(phi_3) - m,
            p_B[1] - l_a * math.cos(theta_3) * math.sin(phi_3) + n,
            p_B[2] + l_a * math.sin(theta_3),
        ]
    )


def test_printed_leg_three_has_the_wrong_length_where_phi_is_the_legs_direction():
    theta_3 = joint_angles(GEOMETRY, OFF_HOME)[2]
    printed = printed_distal_link_of_leg_3(theta_3, OFF_HOME, math.radians(150))
    corrected = distal_link(GEOMETRY, 2, math.cos(theta_3), math.sin(theta_3), *OFF_HOME)
    assert np.linalg.norm(printed) == pytest.approx(0.0889, abs=5e-5)  # given to 0.1 mm
    assert np.linalg.norm(corrected) == pytest.approx(GEOMETRY.l_b, abs=1e-15)  # rounding


def test_printed_leg_three_is_right_only_if_phi_is_the_acute_angle_to_the_x_axis():
    theta_3 = joint_angles(GEOMETRY, OFF_HOME)[2]
    printed = printed_distal_link_of_leg_3(theta_3, OFF_HOME, math.radians(30))
    corrected = distal_link(GEOMETRY, 2, math.cos(theta_3), math.sin(theta_3), *OFF_HOME)
    np.testing.assert_allclose(printed, corrected, rtol=0, atol=1e-16)  # rounding of lengths


# Eq. 8 to 12


def test_eq_8_and_10_hold_with_the_coefficients_the_paper_leaves_out():
    for leg in range(3):
        E, F, G = loop_coefficients(GEOMETRY, leg, *OFF_HOME)
        theta = leg_angle(GEOMETRY, leg, *OFF_HOME)
        t = math.tan(theta / 2)
        # 1e-17 m2: rounding of coefficients around 0.01 m2
        assert E * math.cos(theta) + F * math.sin(theta) + G == pytest.approx(0.0, abs=1e-17)
        assert (G - E) * t**2 + 2 * F * t + (G + E) == pytest.approx(0.0, abs=1e-17)


def test_the_second_cosine_of_eq_9_is_a_sine():
    E, F, G = loop_coefficients(GEOMETRY, 0, *OFF_HOME)
    theta = leg_angle(GEOMETRY, 0, *OFF_HOME)
    t = math.tan(theta / 2)
    first, second = (1 - t**2) / (1 + t**2), 2 * t / (1 + t**2)
    assert second == pytest.approx(math.sin(theta), abs=1e-15)  # rounding
    assert abs(second - math.cos(theta)) > 0.5
    assert E * first + F * second + G == pytest.approx(0.0, abs=1e-17)  # rounding, as above
    assert abs(E * second + F * second + G) > 1e-4


def printed_outward_angle(leg, p_B):
    E, F, G = loop_coefficients(GEOMETRY, leg, *p_B)
    return 2 * math.atan((-F - math.sqrt(E**2 + F**2 - G**2)) / (G - E))


def pose_on_the_locus():
    """Where the paper's own sweep has G = E for leg 1."""

    def difference(y):
        E, _, G = loop_coefficients(GEOMETRY, 0, 0.0, y, -0.105)
        return G - E

    return 0.0, brentq(difference, -0.010, 0.0, xtol=1e-18), -0.105


def test_the_sweep_of_figure_4_crosses_the_locus_where_eq_11_divides_zero_by_zero():
    x, y, z = pose_on_the_locus()
    assert y == pytest.approx(-0.004139, abs=5e-7)  # given to 1 um
    with pytest.raises(ZeroDivisionError):
        printed_outward_angle(0, (x, y, z))


def test_eq_11_loses_the_angle_beside_the_locus_and_the_corrected_form_does_not():
    x, y, z = pose_on_the_locus()
    beside = (x, y + 1e-17, z)
    theta = leg_angle(GEOMETRY, 0, *beside)
    assert abs(math.degrees(printed_outward_angle(0, beside) - theta)) == pytest.approx(17.2, abs=0.05)
    # 1e-15 m: rounding of lengths around 0.1 m
    length = np.linalg.norm(distal_link(GEOMETRY, 0, math.cos(theta), math.sin(theta), *beside))
    assert length == pytest.approx(GEOMETRY.l_b, abs=1e-15)


def test_eq_11_and_the_corrected_form_are_the_same_root_away_from_the_locus():
    # 1e-13: the printed form cancels digits in proportion to G - E
    assert printed_outward_angle(1, HOME) == pytest.approx(leg_angle(GEOMETRY, 1, *HOME), abs=1e-13)


# Eq. 17


def printed_position(theta_l):
    """x and z as functions of y from Eq. 16's differences, then the sphere of leg 3; the lower root."""
    c = np.array([sphere_centre(GEOMETRY, leg, theta) for leg, theta in enumerate(theta_l)]).tolist()
    a_1, b_1, c_1 = (2 * (c[2][k] - c[0][k]) for k in range(3))
    a_2, b_2, c_2 = (2 * (c[2][k] - c[1][k]) for k in range(3))
    d_1, d_2 = (sum(q**2 for q in c[2]) - sum(q**2 for q in c[k]) for k in (0, 1))
    determinant = a_1 * c_2 - a_2 * c_1
    x_0, x_y = (d_1 * c_2 - d_2 * c_1) / determinant, (b_2 * c_1 - b_1 * c_2) / determinant
    z_0, z_y = (a_1 * d_2 - a_2 * d_1) / determinant, (a_2 * b_1 - a_1 * b_2) / determinant
    e_x, e_z = x_0 - c[2][0], z_0 - c[2][2]
    quadratic = [x_y**2 + 1 + z_y**2, 2 * (e_x * x_y - c[2][1] + e_z * z_y)]
    quadratic.append(e_x**2 + c[2][1] ** 2 + e_z**2 - GEOMETRY.l_b**2)
    return min(((x_0 + x_y * y, y, z_0 + z_y * y) for y in np.roots(quadratic)), key=lambda p: p[2])


def test_eq_17_is_the_forward_kinematics_away_from_home():
    # 1e-13 m: the printed elimination divides by a small determinant
    np.testing.assert_allclose(printed_position(joint_angles(GEOMETRY, OFF_HOME)), OFF_HOME, rtol=0, atol=1e-13)


def test_eq_17_divides_by_zero_at_home_and_the_corrected_form_does_not():
    theta_l = [joint_angles(GEOMETRY, HOME)[0]] * 3
    with pytest.raises(ZeroDivisionError):
        printed_position(theta_l)
    np.testing.assert_allclose(position(GEOMETRY, theta_l), HOME, rtol=0, atol=1e-16)  # rounding of lengths


def test_a_sampled_sweep_through_home_meets_the_division_by_zero():
    # the paper's sweep, 10 s at 4 mm/s, seen by 14-bit encoders every millisecond
    y = 0.020 - 0.004 * np.arange(10_001) * 1e-3
    theta_l = joint_angles(GEOMETRY, np.stack([np.zeros_like(y), y, np.full_like(y, -0.105)], axis=-1))
    resolution = 2 * np.pi / 2**14
    counts = np.round(theta_l / resolution)
    singular = np.flatnonzero((counts == counts[:, :1]).all(axis=1))
    assert len(singular) == 5
    for tick in singular:
        with pytest.raises(ZeroDivisionError):
            printed_position([counts[tick, 0] * resolution] * 3)


# Eq. 21 to 27


def force_by_the_papers_route(theta_l, tau_l, into_leg_frame):
    """Eq. 21-27 with the force vectors F_Ai e_i, entering frame O_i by the given rotation, in degrees."""
    p_B = position(GEOMETRY, theta_l)
    F_ee_B = np.zeros(3)
    for leg in range(3):
        link = np.array(distal_link(GEOMETRY, leg, math.cos(theta_l[leg]), math.sin(theta_l[leg]), *p_B))
        e = rotation(into_leg_frame[leg]) @ (link / np.linalg.norm(link))
        lever = GEOMETRY.l_a * (math.sin(theta_l[leg]) * e[1] - math.cos(theta_l[leg]) * e[2])
        F_ee_B += rotation(-into_leg_frame[leg]) @ (tau_l[leg] / lever * e)
    return F_ee_B


PRINTED, CORRECTED = (0, 120, -120), (0, -120, 120)


def test_the_rotations_of_eq_23_are_swapped():
    theta_l = joint_angles(GEOMETRY, HOME)
    tau_l = joint_torques(GEOMETRY, HOME, (0.0, 0.0, -5.005))
    printed = force_by_the_papers_route(theta_l, tau_l, PRINTED)
    np.testing.assert_allclose(printed, (0.0, -0.890, -6.975), rtol=0, atol=5e-4)  # given to 1 mN
    corrected = force_by_the_papers_route(theta_l, tau_l, CORRECTED)
    np.testing.assert_allclose(corrected, (0.0, 0.0, -5.005), rtol=0, atol=1e-14)  # rounding of 5 N
    np.testing.assert_allclose(corrected, end_effector_force(GEOMETRY, theta_l, tau_l), rtol=0, atol=1e-14)


def test_eq_23_and_24_turn_vectors_away_from_the_frames_the_text_describes():
    for leg in range(3):
        outward = np.array([LEG_COS[leg], LEG_SIN[leg], 0.0])
        # in its own frame every leg points along -y, as leg 1 does in B; 1e-15: rounding of unit vectors
        np.testing.assert_allclose(rotation(CORRECTED[leg]) @ outward, (0.0, -1.0, 0.0), rtol=0, atol=1e-15)
    for leg in (1, 2):
        outward = np.array([LEG_COS[leg], LEG_SIN[leg], 0.0])
        assert np.linalg.norm(rotation(PRINTED[leg]) @ outward - [0.0, -1.0, 0.0]) > 1.0


def test_calibrating_at_home_hides_the_swap_and_leaves_a_false_side_force():
    press = (0.0, 0.0, -5.005)

    def printed(p_B):
        return force_by_the_papers_route(joint_angles(GEOMETRY, p_B), joint_torques(GEOMETRY, p_B, press), PRINTED)

    calibration = press[2] / printed(HOME)[2]
    assert calibration * printed(HOME)[2] == pytest.approx(press[2], rel=1e-15)  # rounding
    # at the end of the sweep the paper's route reports 1.1 N sideways where there is none
    _, F_y, _ = calibration * printed((0.0, -0.020, -0.105))
    assert abs(F_y) == pytest.approx(1.13, abs=0.03)


def test_eq_26_rotates_a_magnitude_and_gives_no_vector():
    theta_l = joint_angles(GEOMETRY, OFF_HOME)
    tau_l = np.array([0.1, 0.2, -0.1])
    magnitude = 1.7  # any F_A2: "we can obtain these force magnitudes"
    assert (rotation(-120) * magnitude).shape == (3, 3)
    corrected = force_by_the_papers_route(theta_l, tau_l, CORRECTED)
    # 1e-14: rounding of forces around 5 N
    np.testing.assert_allclose(corrected, jacobian(GEOMETRY, OFF_HOME).T @ tau_l, rtol=0, atol=1e-14)


def test_eq_25_holds_about_the_joint_axis_only():
    theta = joint_angles(GEOMETRY, OFF_HOME)[0]
    link = np.array(distal_link(GEOMETRY, 0, math.cos(theta), math.sin(theta), *OFF_HOME))
    e = link / GEOMETRY.l_b
    tau_l = 0.1
    F_A = tau_l / (GEOMETRY.l_a * (math.sin(theta) * e[1] - math.cos(theta) * e[2]))
    arm = GEOMETRY.l_a * np.array([0.0, -math.cos(theta), -math.sin(theta)])
    moment = np.cross(arm, F_A * e)
    assert moment[0] == pytest.approx(tau_l, rel=1e-14)  # rounding
    assert np.linalg.norm(moment[1:]) > 0.01  # carried by the joint's bearing


def test_eq_27_is_the_force_on_the_environment_so_pressing_is_minus_its_z():
    theta_l = joint_angles(GEOMETRY, HOME)
    _, _, F_z_printed = end_effector_force(GEOMETRY, theta_l, (0.125, 0.125, 0.125))
    # the torques that lower the platform press; the text's reference for a press is +5 N
    assert position(GEOMETRY, theta_l + 1e-3)[2] < HOME[2]
    assert -F_z_printed == pytest.approx(5.0, abs=0.01)  # 0.125 N m is itself rounded


# the statics' missing weight


@pytest.mark.parametrize(("p_B", "F_z"), [(HOME, -2.20), (START, -2.35)])
def test_in_free_air_eq_27_reports_the_robots_weight_and_would_trigger_a_force_loop_that_takes_its_size(p_B, F_z):
    theta_l = joint_angles(GEOMETRY, p_B)
    weight = environment_force(GEOMETRY, MASSES, theta_l, p_B, (0.0, 0.0, 0.0))
    tau_l = joint_torques(GEOMETRY, p_B, -np.array(weight))  # the springs hold the robot still
    printed = end_effector_force(GEOMETRY, theta_l, tau_l)
    assert -printed[2] == pytest.approx(F_z, abs=0.005)  # given to 0.01 N
    assert abs(printed[2]) > 0.6
    corrected = environment_force(GEOMETRY, MASSES, theta_l, p_B, tau_l)
    np.testing.assert_allclose(corrected, 0.0, rtol=0, atol=1e-14)  # rounding of 2 N


# Eq. 18 and 20


def test_constant_efficiency_creates_power_when_the_load_drives_the_spring():
    k_s, N, eta, d, thetadot_l, rate = 1.0, 2.0, 0.8, 0.1, -0.5, 1e-3

    def power_lost(tau_l):
        return k_s * d * N * thetadot_l - tau_l * thetadot_l

    assert power_lost(load_torque(k_s, N, eta, d)) < 0.0
    assert power_lost(directed_load_torque(k_s, N, eta, d, thetadot_l, rate)) > 0.0


def test_constant_efficiency_is_right_while_the_spring_drives_the_load():
    k_s, N, eta, d, thetadot_l, rate = 1.0, 2.0, 0.8, 0.1, 0.5, 1e-3
    directed = directed_load_torque(k_s, N, eta, d, thetadot_l, rate)
    assert directed == pytest.approx(load_torque(k_s, N, eta, d), rel=1e-14)  # tanh(500) = 1, rounding
