"""Every constant of the plant, SI."""

import math
from typing import NamedTuple

from twin.cosim.record import record_of

Triple = tuple[float, float, float]


class PlantParameters(NamedTuple):
    """The robot and what it presses on, as they really are (not as the controller believes).

    Attributes:
        a, b, l_a, l_b: geometry of Fig. 2 (m).
        m_a, m_b, m_p: proximal link, rod pair, platform (kg).
        I_r: pulley and arm fittings about the joint (kg m2).
        b_j: viscous damping of a joint (N m s/rad).
        k_s, N, eta: spring stiffness (N m/rad), belt ratio, belt efficiency (Eq. 18-20).
        backlash: half width of the dead zone of the spring deflection, motor side (rad).
        eta_rate: joint speed (rad/s) over which a direction-dependent efficiency turns over; 0: eta is constant (the
            paper's model).
        z_s: height of the surface on the z axis of B (m).
        tilt: its rotation about y (rad).
        K, damping: contact stiffness (N/m) and Hunt-Crossley damping (s/m), see `contact_law.py`.
        mu, sigma_0, sigma_1: friction coefficient, bristle stiffness (N/m) and damping (N s/m).
        tilt_x: rotation of the surface about its own x axis, before `tilt` (rad).
        shape, radius: one of `surface.Shape` and the radius of curvature (m).
        law: one of `contact_law.Law`.
        exponent, reference_depth: of Hunt and Crossley's law; K is its secant stiffness at this depth (m).
        stiffening: exponential law, relative growth of the stiffness per depth (1/m).
        damper, touch_depth: Kelvin-Voigt damper (N s/m) and the depth over which it fades in (m).
        k_s_share: what is left of k_s in each joint's spring (1); 0: broken.
        backlash_added, b_j_added: wear of each joint, on top of backlash (rad) and b_j (N m s/rad).
        slip: how far each belt has slipped, as wind-up the spring has lost, motor side (rad).
        belt_compliance: turn of the joint per torque on it that the belt yields by (rad per N m), see
            `dynamics.series_share`.
        joint_friction, joint_presliding: dry friction of a joint (N m), and how far it yields before it slides (rad,
            > 0).
        spring_hysteresis: of a spring, as a share of its torque (1).
        spring_stop, joint_lower, joint_upper, stop: hard stops of spring (rad, motor side) and joint (rad) and their
            stiffness (N m/rad), see `friction.py`.
        mounting_tilt, mounting_tilt_x: of the base about its y and x axes (rad), see `mounting.py`.
        head: where the head touches, seen from O_P (m).

    k_s_share to slip are each joint's condition; their defaults are a robot as it was built. Those of what follows are
    a robot without that effect.
    """

    a: float
    b: float
    l_a: float
    l_b: float
    m_a: float
    m_b: float
    m_p: float
    I_r: float
    b_j: float
    k_s: float
    N: float
    eta: float
    backlash: float
    eta_rate: float
    z_s: float
    tilt: float
    K: float
    damping: float
    mu: float
    sigma_0: float
    sigma_1: float
    tilt_x: float = 0.0
    shape: int = 0
    radius: float = math.inf
    law: int = 0
    exponent: float = 1.0
    reference_depth: float = 1e-3
    stiffening: float = 0.0
    damper: float = 0.0
    touch_depth: float = 1e-3
    k_s_share: Triple = (1.0, 1.0, 1.0)
    backlash_added: Triple = (0.0, 0.0, 0.0)
    b_j_added: Triple = (0.0, 0.0, 0.0)
    slip: Triple = (0.0, 0.0, 0.0)
    belt_compliance: float = 0.0
    joint_friction: float = 0.0
    joint_presliding: float = math.radians(0.05)
    spring_hysteresis: float = 0.0
    spring_stop: float = math.inf
    joint_lower: float = -math.inf
    joint_upper: float = math.inf
    stop: float = 100.0
    mounting_tilt: float = 0.0
    mounting_tilt_x: float = 0.0
    head: Triple = (0.0, 0.0, 0.0)


PARAMETERS = record_of(PlantParameters)
"""`PlantParameters` as a record: numbers, and arrays (3,) where the tuple holds three."""

STATES = 8
"""The state x: platform position p_B (m), velocity v_B (m/s), bristle deflection z_b in the surface (m)."""
