"""Unit quaternions (x, y, z, w) as tuples, Hamilton's product; each turns vectors, not axes.

Compiled; where one is drawn once only, Python takes `py_func`, for which nothing is compiled.
"""

import math

from twin.compiled.function import njit

X, Y, Z = 0, 1, 2
IDENTITY = (0.0, 0.0, 0.0, 1.0)


@njit(cache=True)
def turn(axis, angle):
    """Right-handed turn by `angle` (rad) about the axis X, Y or Z."""
    sin, cos = math.sin(0.5 * angle), math.cos(0.5 * angle)
    return (sin if axis == X else 0.0, sin if axis == Y else 0.0, sin if axis == Z else 0.0, cos)


@njit(cache=True)
def product(p, q):
    """First the turn `q`, then `p`, both about fixed axes."""
    p_x, p_y, p_z, p_w = p
    q_x, q_y, q_z, q_w = q
    return (
        p_w * q_x + p_x * q_w + p_y * q_z - p_z * q_y,
        p_w * q_y - p_x * q_z + p_y * q_w + p_z * q_x,
        p_w * q_z + p_x * q_y - p_y * q_x + p_z * q_w,
        p_w * q_w - p_x * q_x - p_y * q_y - p_z * q_z,
    )


@njit(cache=True)
def leaning(azimuth, lowered):
    """The right-handed turn about y by `lowered`, then about z by `azimuth` (rad)."""
    return product(turn(Z, azimuth), turn(Y, lowered))


@njit(cache=True)
def pointing(x, y, z):
    """A turn that takes e_x to the direction of (x, y, z): about y, then about z; none where that is 0."""
    # a right-handed turn about y lowers e_x
    return leaning(math.atan2(y, x), math.atan2(-z, math.hypot(x, y)))
