"""The robot's own weight and inertia, which the paper's statics leave out.

All rods are uniform, so the weight of a distal rod pair hangs half at A_i and half at the platform; what its inertia
does is in `plant.dynamics`. Positive theta_l lowers the arm, so its weight is a positive torque.
"""

import math
from typing import NamedTuple

import numpy as np
from numpy.typing import ArrayLike, NDArray

from twin.compiled.function import njit
from twin.compiled.native import entry
from twin.robot.geometry import Geometry
from twin.robot.jacobian import jacobian_row

G_ACCELERATION = 9.81


class Masses(NamedTuple):
    """Masses (kg) and inertia (kg m^2) of the moving parts, m_a and m_b as in Fig. 2.

    The compiled functions read these attributes only, so they also accept any other record that has them.

    Attributes:
        m_a: one proximal rod.
        m_b: the two rods of one distal link together.
        m_p: platform.
        I_r: what turns with one proximal link besides the rod: pulley and encoder, about the joint axis.
    """

    m_a: float
    m_b: float
    m_p: float
    I_r: float


@njit(cache=True)
def arm_gravity_torque(geometry, masses, theta):
    """Torque in N m with which one arm's weight turns its joint: (m_a/2 + m_b/2) g l_a cos(theta)."""
    return arm_weight(masses) * geometry.l_a * math.cos(theta)


@njit(cache=True)
def arm_weight(masses):
    """Weight in N that hangs at one knee A_i: (m_a/2 + m_b/2) g."""
    return 0.5 * (masses.m_a + masses.m_b) * G_ACCELERATION


@njit(cache=True)
def platform_weight(masses):
    """Weight in N that hangs at the platform: (m_p + 3/2 m_b) g."""
    return (masses.m_p + 1.5 * masses.m_b) * G_ACCELERATION


@njit(cache=True)
def moving_mass(masses):
    """Mass in kg that the platform's own acceleration feels: m_p + m_b, of three uniform rod pairs."""
    return masses.m_p + masses.m_b


@njit(cache=True)
def leg_inertia(geometry, masses):
    """Inertia in kg m^2 that a joint's own acceleration feels: (m_a + m_b) l_a^2/3 + I_r, of uniform rods."""
    return (masses.m_a + masses.m_b) / 3.0 * geometry.l_a * geometry.l_a + masses.I_r


@njit(cache=True)
def environment_force(geometry, masses, theta_l, p_B, tau_l):
    """Force F_ee_B in N by the robot at rest on its environment, its own weight included: ``(x, y, z)``.

    F_ee_B = J^T (tau_l + arm gravity torque) - platform weight e_z: Eq. 27 corrected for gravity.

    Args:
        geometry, masses: records with the attributes of Geometry and Masses.
        theta_l, p_B, tau_l: joint angles in rad, the platform position in m that belongs to them and load
            torques in N m, anything that can be indexed 0..2.
    """
    F_x, F_y, F_z = 0.0, 0.0, -platform_weight(masses)
    for leg in range(3):
        j_x, j_y, j_z = jacobian_row(geometry, leg, theta_l[leg], p_B[0], p_B[1], p_B[2])
        tau = tau_l[leg] + arm_gravity_torque(geometry, masses, theta_l[leg])
        F_x += j_x * tau
        F_y += j_y * tau
        F_z += j_z * tau
    return F_x, F_y, F_z


@entry("nothing", "doubles", "doubles", "doubles", "doubles", "doubles", "doubles")
def _press(lengths, weights, theta_l, p_B, tau_l, F_ee_B):
    geometry = Geometry(lengths[0], lengths[1], lengths[2], lengths[3])
    masses = Masses(weights[0], weights[1], weights[2], weights[3])
    F_ee_B[0], F_ee_B[1], F_ee_B[2] = environment_force(geometry, masses, theta_l, p_B, tau_l)


def force_on_environment(
    geometry: Geometry, masses: Masses, theta_l: ArrayLike, p_B: ArrayLike, tau_l: ArrayLike
) -> NDArray:
    """`environment_force` (3,) in N, as compiled code has it to the last bit."""
    force = np.empty(3)
    arrays = (np.array(values, dtype=np.float64) for values in (geometry, masses, theta_l, p_B, tau_l))
    _press(*arrays, force)
    return force
