"""What the controller believes of the robot: its own model, not the plant's parameters."""

from typing import NamedTuple

from twin.cosim.record import record_of


class Belief(NamedTuple):
    """The controller's model, SI.

    Attributes:
        a, b, l_a, l_b: geometry of Fig. 2 (m).
        m_a, m_b, m_p: masses whose weight the force estimate takes off (kg).
        k_s, N, eta: series elastic joint (Eq. 20).
        motor_counts, joint_counts: encoder counts per turn.
        motor_zero, joint_zero: encoder zero errors known from calibration (3,), rad.
        backlash: half width of the springs' dead zone, motor side (rad); 0: the paper's estimator, blind to it.
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
    motor_counts: float
    joint_counts: float
    motor_zero: tuple[float, float, float]
    joint_zero: tuple[float, float, float]
    backlash: float = 0.0


BELIEF = record_of(Belief)
