"""The robot's geometry (Fig. 2) and the vectors of one leg, Eq. 3-6.

Leg i (1..3 in the paper, ``leg`` = 0..2 here) stands at phi_i = -90, 30, 150 degrees about z of the base
frame B. Its proximal link turns in the vertical plane through phi_i. theta_i is zero with the link horizontal
and outward; positive theta_i lowers A_i, as printed in Eq. 5.
"""

import math
from typing import NamedTuple

from twin.compiled.function import njit
from twin.compiled.lanes import three

# exact, because sin and cos of phi_i in floating point are off by up to 1e-16 and would tilt the symmetry
LEG_COS = (0.0, math.sqrt(3.0) / 2.0, -math.sqrt(3.0) / 2.0)
LEG_SIN = (-1.0, 0.5, 0.5)


class Geometry(NamedTuple):
    """Lengths of Fig. 2, all in m.

    The compiled functions of this package read these four attributes only, so they also accept any other
    record that has them.

    Attributes:
        a: distance from the base centre O_B to each base joint B_i.
        b: distance from the platform centre O_P to each platform joint P_i.
        l_a: length of the proximal link B_iA_i.
        l_b: length of the distal link A_iP_i.
    """

    a: float
    b: float
    l_a: float
    l_b: float


@njit(cache=True)
def leg_coordinates(geometry, leg, x, y):
    """Where P_i stands horizontally in leg i's own plane, for the platform at (x, y): ``(u, w)`` in m.

    u_i = p_x cos(phi_i) + p_y sin(phi_i) - (a - b) is the distance from B_i to P_i along the leg's outward
    direction, w_i = -p_x sin(phi_i) + p_y cos(phi_i) the distance out of the plane in which the
    proximal link moves.
    """
    return coordinates_along(geometry, LEG_COS[leg], LEG_SIN[leg], x, y)


@njit(cache=True, forceinline=True)
def legs():
    """cos(phi_i) and sin(phi_i) of all legs, `compiled.lanes`."""
    return three(LEG_COS[0], LEG_COS[1], LEG_COS[2]), three(LEG_SIN[0], LEG_SIN[1], LEG_SIN[2])


@njit(cache=True, forceinline=True)
def coordinates_along(geometry, C, S, x, y):
    """As `leg_coordinates`, of the leg with cos(phi_i) = `C` and sin(phi_i) = `S`."""
    u = x * C + y * S - (geometry.a - geometry.b)
    w = -x * S + y * C
    return u, w


@njit(cache=True)
def distal_link(geometry, leg, cos_theta, sin_theta, x, y, z):
    """Vector A_iP_i of leg i in the base frame, Eq. 6, in m: ``(x, y, z)``.

    The printed third row of Eq. 6 has the x term of leg 3 with the wrong sign; with
    A_iP_i = p + (b - a - l_a cos(theta_i)) (cos(phi_i), sin(phi_i), 0) + l_a sin(theta_i) e_z
    all three legs are one equation.
    """
    outward = geometry.b - geometry.a - geometry.l_a * cos_theta
    return (
        x + outward * LEG_COS[leg],
        y + outward * LEG_SIN[leg],
        z + geometry.l_a * sin_theta,
    )
