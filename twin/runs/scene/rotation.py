"""Unit quaternions (x, y, z, w) along the last axis of an array, Hamilton's product; each turns vectors, not axes."""

import numpy as np
from numpy.typing import ArrayLike, NDArray

X, Y, Z = 0, 1, 2
IDENTITY = np.array([0.0, 0.0, 0.0, 1.0])


def turn(axis: int, angle: ArrayLike) -> NDArray[np.float64]:
    """Right-handed turn by `angle` (rad, (...)) about the axis X, Y or Z, (..., 4)."""
    half = 0.5 * np.asarray(angle, dtype=np.float64)
    q = np.zeros((*half.shape, 4))
    q[..., axis] = np.sin(half)
    q[..., 3] = np.cos(half)
    return q


def product(p: NDArray[np.float64], q: NDArray[np.float64]) -> NDArray[np.float64]:
    """First the turn `q`, then `p`, both about fixed axes; (..., 4)."""
    # e_i times e_j component by component: numpy's cross product of few short vectors costs ten times as much
    p_x, p_y, p_z, p_w = p[..., 0], p[..., 1], p[..., 2], p[..., 3]
    q_x, q_y, q_z, q_w = q[..., 0], q[..., 1], q[..., 2], q[..., 3]
    r = np.empty(np.broadcast_shapes(p.shape, q.shape))
    r[..., 0] = p_w * q_x + p_x * q_w + p_y * q_z - p_z * q_y
    r[..., 1] = p_w * q_y - p_x * q_z + p_y * q_w + p_z * q_x
    r[..., 2] = p_w * q_z + p_x * q_y - p_y * q_x + p_z * q_w
    r[..., 3] = p_w * q_w - p_x * q_x - p_y * q_y - p_z * q_z
    return r


def leaning(azimuth: ArrayLike, lowered: ArrayLike) -> NDArray[np.float64]:
    """The right-handed turn about y by `lowered`, then about z by `azimuth` (rad, shapes that broadcast), (..., 4).

    It is `product(turn(Z, azimuth), turn(Y, lowered))`, most of whose terms are 0; so that 0 has no sign here either.
    """
    half, other = 0.5 * np.asarray(azimuth, dtype=np.float64), 0.5 * np.asarray(lowered, dtype=np.float64)
    sin, cos, other_sin, other_cos = np.sin(half), np.cos(half), np.sin(other), np.cos(other)
    q = np.empty((*np.broadcast_shapes(half.shape, other.shape), 4))
    q[..., 0] = 0.0 - sin * other_sin
    q[..., 1] = 0.0 + cos * other_sin
    q[..., 2] = 0.0 + sin * other_cos
    q[..., 3] = cos * other_cos
    return q


def pointing(v: NDArray[np.float64]) -> NDArray[np.float64]:
    """A turn that takes e_x to the direction of `v`, (..., 3): about y, then about z; none where v is 0."""
    # a right-handed turn about y lowers e_x
    return leaning(np.arctan2(v[..., Y], v[..., X]), np.arctan2(-v[..., Z], np.hypot(v[..., X], v[..., Y])))
