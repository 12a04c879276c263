"""What one encoder count is worth in the quantities that the monitor limits: below that nothing can be told apart."""

from typing import NamedTuple

import numpy as np
from numpy.typing import ArrayLike

from twin.monitor.belief import MonitorBelief
from twin.robot.geometry import Geometry
from twin.robot.gravity import Masses, force_on_environment
from twin.robot.inverse_kinematics import joint_angles
from twin.robot.jacobian import jacobian
from twin.robot.sea import load_torque


class Resolution(NamedTuple):
    """Worst case of one count on every encoder at once, SI.

    Attributes:
        wind_up: of a spring on the motor's side (rad).
        motor_speed: one motor count from one sample to the next (rad/s).
        jump: the same of a wind-up: motor and joint count together (rad/s).
        force: length of the force (N).
        force_rate: that per sample (N/s).
        position: of the platform (m).
        velocity: that per sample (m/s).
    """

    wind_up: float
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
    wind_up = motor + belief.N * joint
    force = float(load_torque(belief.k_s, belief.N, belief.eta, wind_up)) * float(np.linalg.norm(J, axis=1).sum())
    position = joint * float(np.linalg.norm(np.linalg.inv(J), axis=0).sum())
    return Resolution(
        wind_up=wind_up,
        motor_speed=motor / dt,
        jump=wind_up / dt,
        force=force,
        force_rate=force / dt,
        position=position,
        velocity=position / dt,
    )


def press_wind_up(belief: MonitorBelief, p_B: ArrayLike, force: float) -> float:
    """Largest wind-up (rad, motor side) of a spring while the robot at `p_B` (3,), m, presses down with `force` (N).

    tau_l = J^-T (F_ee_B + own weight) with F_ee_B = (0, 0, -force), and Eq. 20; the dead zone comes on top.

    Raises:
        Unreachable: the robot cannot stand there.
    """
    shape = geometry(belief)
    theta_l, J = joint_angles(shape, p_B), jacobian(shape, p_B)
    masses = Masses(belief.m_a, belief.m_b, belief.m_p, 0.0)
    unwound = force_on_environment(shape, masses, theta_l, p_B, np.zeros(3))
    tau_l = np.linalg.solve(J.T, np.array([0.0, 0.0, -force]) - unwound)
    return float(np.abs(tau_l).max() / load_torque(belief.k_s, belief.N, belief.eta, 1.0) + belief.backlash)


def geometry(belief: MonitorBelief) -> Geometry:
    """The lengths of Fig. 2 that the monitor believes."""
    return Geometry(belief.a, belief.b, belief.l_a, belief.l_b)
