"""What the monitor believes of the robot: its own record, so that the controller's wrong model is not also its own."""

from typing import NamedTuple

from twin.cosim.record import record_of


class MonitorBelief(NamedTuple):
    """The monitor's model of the robot, SI.

    Attributes:
        a, b, l_a, l_b: geometry of Fig. 2 (m).
        m_a, m_b, m_p: masses whose weight the force estimate takes off (kg).
        k_s, N, eta: series elastic joint (Eq. 20).
        backlash: half width of the dead zone of the spring deflection, motor side (rad).
        motor_counts, joint_counts: encoder counts per turn.
        motor_zero, joint_zero: encoder zero errors known from calibration (3,), rad.
    """

    a: float
    b: float
    l_a: float
    l_b: float
    m_a: float
    m_b: float
    m_p: float
    k_s: float
    N: float
    eta: float
    backlash: float
    motor_counts: float
    joint_counts: float
    motor_zero: tuple[float, float, float]
    joint_zero: tuple[float, float, float]


BELIEF = record_of(MonitorBelief)
