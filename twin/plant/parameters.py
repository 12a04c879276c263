"""Every constant of the plant, SI."""

from typing import NamedTuple

import numpy as np


class PlantParameters(NamedTuple):
    """The robot and what it presses on, as they really are (not as the controller believes).

    Attributes:
        a, b, l_a, l_b: geometry of Fig. 2 (m).
        m_a, m_b, m_p: proximal link, rod pair, platform (kg). I_r: pulley and arm fittings about the joint (kg m2).
        b_j: viscous damping of a joint (N m s/rad).
        k_s, N, eta: spring stiffness (N m/rad), belt ratio, belt efficiency (Eq. 18-20).
        backlash: half width of the dead zone of the spring deflection, motor side (rad).
        eta_rate: joint speed (rad/s) over which a direction-dependent efficiency turns over; 0: eta is constant (the
            paper's model).
        z_s: height of the surface on the z axis of B (m). tilt: its rotation about y (rad).
        K, damping: contact stiffness (N/m) and Hunt-Crossley damping (s/m), F_n = K d (1 + damping d_dot).
        mu, sigma_0, sigma_1: friction coefficient, bristle stiffness (N/m) and damping (N s/m).
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


PARAMETERS = np.dtype([(name, "f8") for name in PlantParameters._fields], align=True)

STATES = 8
"""The state x: platform position p_B (m), velocity v_B (m/s), bristle deflection z_b in the surface (m)."""
