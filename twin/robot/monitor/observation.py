"""Quantities that the monitor computes from encoder messages with its own model of the robot.

What the monitor believes of the robot: its own record, so that the controller's wrong model is not also its own.

What the monitor makes of an encoder message: pose, speeds and force, by its own belief and its own low-pass.

What one encoder count is worth in the quantities that the monitor limits: smaller differences cannot be seen.
"""

import math
from typing import NamedTuple

import numpy as np
from numpy.typing import ArrayLike

from twin.kernel.compiled.function import njit
from twin.kernel.cosim.port import record, record_of, states
from twin.kernel.settings import Values, setting, taken
from twin.robot.mechanism.geometry import Geometry, Model
from twin.robot.mechanism.kinematics import jacobian, joint_angles, platform_position
from twin.robot.mechanism.statics import (
    Masses,
    dead_zone,
    deflection,
    environment_force,
    force_on_environment,
    load_torque,
)


class MonitorBelief(
    Values,
    parts=(
        taken(Model),
        {"backlash": setting("rad", help="half width of the dead zone of the spring deflection, motor side")},
        taken(Model, into="encoders"),
    ),
):
    """The monitor's model of the robot, SI."""


BELIEF = record_of(MonitorBelief)


class Resolution(NamedTuple):
    """Worst case of one count on every encoder at once, SI.

    Attributes:
        deflection: of a spring on the motor's side (rad).
        motor_speed: one motor count from one sample to the next (rad/s).
        jump: the same of a deflection: motor and joint count together (rad/s).
        force: length of the force (N).
        force_rate: that per sample (N/s).
        position: of the platform (m).
        velocity: that per sample (m/s).
    """

    deflection: float
    motor_speed: float
    jump: float
    force: float
    force_rate: float
    position: float
    velocity: float


def resolution(belief: MonitorBelief, p_B: ArrayLike, dt: float) -> Resolution:
    """What one count is worth with the platform at `p_B` (3,), m, and `dt` (s) between samples.

    F = J^T tau_l and v = J^-1 dtheta_l/dt; the worst case over the signs of the three joints is bounded by the sum of
    the lengths of the rows of J and of the columns of J^-1.

    Raises:
        Unreachable: the robot cannot stand there.
    """
    J = jacobian(geometry(belief), p_B)
    motor, joint = 2.0 * np.pi / belief.motor_counts, 2.0 * np.pi / belief.joint_counts
    deflected = motor + belief.N * joint
    force = float(load_torque(belief.k_s, belief.N, belief.eta, deflected)) * float(np.linalg.norm(J, axis=1).sum())
    position = joint * float(np.linalg.norm(np.linalg.inv(J), axis=0).sum())
    return Resolution(
        deflection=deflected,
        motor_speed=motor / dt,
        jump=deflected / dt,
        force=force,
        force_rate=force / dt,
        position=position,
        velocity=position / dt,
    )


def press_deflection(belief: MonitorBelief, p_B: ArrayLike, force: float) -> float:
    """Largest deflection (rad, motor side) of a spring while the robot at `p_B` (3,), m, presses down with `force` (N).

    tau_l = J^-T (F_ee_B + own weight) with F_ee_B = (0, 0, -force), and Eq. 20; the dead zone comes on top.

    Raises:
        Unreachable: the robot cannot stand there.
    """
    shape = geometry(belief)
    theta_l, J = joint_angles(shape, p_B), jacobian(shape, p_B)
    masses = Masses(belief.m_a, belief.m_b, belief.m_p, 0.0)
    unloaded = force_on_environment(shape, masses, theta_l, p_B, np.zeros(3))
    tau_l = np.linalg.solve(J.T, np.array([0.0, 0.0, -force]) - unloaded)
    return float(np.abs(tau_l).max() / load_torque(belief.k_s, belief.N, belief.eta, 1.0) + belief.backlash)


def geometry(belief: MonitorBelief) -> Geometry:
    """The lengths of Fig. 2 that the monitor believes."""
    return Geometry(belief.a, belief.b, belief.l_a, belief.l_b)


SEEN = record(
    **states(
        started="i8",
        theta_m="3f8",
        theta_l="3f8",
        moved_m="3i8",
        moved_l="3i8",
        deflection="3f8",
        tau_l="3f8",
        fastest="3f8",
        omega_m="3f8",
        omega_l="3f8",
        omega_cmd="3f8",
        p_B="3f8",
        v_B="3f8",
        F_ee_B="3f8",
        speed="f8",
        force="f8",
        force_rate="f8",
        touching="i8",
        z_touch="f8",
        depth="f8",
        contact_ticks="i8",
    ),
)
"""The last observation: angles (rad), whether an encoder moved a count, deflection (rad), joint torques (N m), fastest
change since the sample before on the motor's side (rad/s); low-passed: motor speed, joint speed on the motor's side and
commanded speed (rad/s), velocity (m/s), speed (m/s), force (N) and the growth of its length (N/s); position (m); the
contact: height where it began (m), depth below that (m), duration (ticks)."""


@njit(cache=True)
def angle(count, counts_per_turn, zero):
    """Angle (rad) that an encoder count stands for."""
    return count * (2.0 * np.pi / counts_per_turn) - zero


@njit(cache=True)
def low_pass_share(corner, dt):
    """How much of a new sample a first-order low-pass with `corner` (Hz) takes over after `dt` (s)."""
    return 1.0 - math.exp(-2.0 * math.pi * corner * dt)


@njit(cache=True, error_model="numpy")
def observe_joints(belief, seen, share, dt, count_m, count_l, sent):
    """Angles, speeds and torques of the three joints from counts (3,) each, `dt` (s) after the sample before.

    Args:
        sent: commanded motor speeds since the sample before (3,), rad/s.
    """
    for i in range(3):
        theta_m = angle(count_m[i], belief.motor_counts, belief.motor_zero[i])
        theta_l = angle(count_l[i], belief.joint_counts, belief.joint_zero[i])
        if seen.started:
            rate_m = (theta_m - seen.theta_m[i]) / dt
            rate_l = belief.N * (theta_l - seen.theta_l[i]) / dt
            seen.moved_m[i] = theta_m != seen.theta_m[i]
            seen.moved_l[i] = theta_l != seen.theta_l[i]
            seen.fastest[i] = max(abs(rate_m), abs(rate_l), abs(rate_m - rate_l))
            seen.omega_m[i] += share * (rate_m - seen.omega_m[i])
            seen.omega_l[i] += share * (rate_l - seen.omega_l[i])
            seen.omega_cmd[i] += share * (sent[i] - seen.omega_cmd[i])
        seen.theta_m[i], seen.theta_l[i] = theta_m, theta_l
        seen.deflection[i] = deflection(theta_m, theta_l, belief.N)
        seen.tau_l[i] = load_torque(belief.k_s, belief.N, belief.eta, dead_zone(seen.deflection[i], belief.backlash))


@njit(cache=True, error_model="numpy")
def observe_platform(belief, seen, share, dt):
    """Position, velocity and force of the platform from the joints; False, and nothing changes, if they fit no pose.

    F_ee_B = J^T (tau_l + arm gravity) - weight e_z: Eq. 21-27 corrected and gravity-compensated.
    """
    x, y, z = platform_position(belief, seen.theta_l[0], seen.theta_l[1], seen.theta_l[2])
    p = (x, y, z)
    F = environment_force(belief, belief, seen.theta_l, p, seen.tau_l)
    # at the edge of the workspace the Jacobian is infinite
    if not math.isfinite(x + F[0] + F[1] + F[2]):
        return False
    if not seen.started:
        for i in range(3):
            seen.p_B[i], seen.F_ee_B[i] = p[i], F[i]
        seen.force = math.sqrt(F[0] * F[0] + F[1] * F[1] + F[2] * F[2])
        return True
    v2, F2 = 0.0, 0.0
    for i in range(3):
        seen.v_B[i] += share * ((p[i] - seen.p_B[i]) / dt - seen.v_B[i])
        seen.F_ee_B[i] += share * (F[i] - seen.F_ee_B[i])
        seen.p_B[i] = p[i]
        v2 += seen.v_B[i] * seen.v_B[i]
        F2 += seen.F_ee_B[i] * seen.F_ee_B[i]
    seen.speed = math.sqrt(v2)
    seen.force_rate = (math.sqrt(F2) - seen.force) / dt
    seen.force = math.sqrt(F2)
    return True


@njit(cache=True)
def observe_contact(seen, contact_force, ticks):
    """Where and how long the robot presses: a contact begins at `contact_force` (N) and ends at half of it."""
    F_z = -seen.F_ee_B[2]
    if not seen.touching and F_z >= contact_force:
        seen.touching = 1
        seen.z_touch = seen.p_B[2]
        seen.contact_ticks = 0
    elif seen.touching and F_z < 0.5 * contact_force:
        seen.touching = 0
    if seen.touching:
        seen.contact_ticks += ticks
        seen.depth = max(0.0, seen.z_touch - seen.p_B[2])
    else:
        seen.contact_ticks = 0
        seen.depth = 0.0
