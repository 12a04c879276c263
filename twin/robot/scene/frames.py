"""Where every part of the robot is: a frame each, relative to the base frame B.

    link_i              origin B_i, x along the proximal link to A_i, y along the joint's axis
    rod_i_minus, _plus  origin at A_i, half the parallelogram's width to either side along the axis; x along the rod
                        to the platform. It turns about y with the link's joint and swings about its own z
    platform            origin O_P, axes those of B: the parallelograms keep it so (Sec. II.A)
    surface             origin at the surface's apex, z its normal there

All are the truth: joints of `twin.robot.mechanism.geometry`, the surface of `twin.robot.plant.contact`.

Unit quaternions (x, y, z, w) as tuples, Hamilton's product; each turns vectors, not axes. Compiled; where one is drawn
once only, Python takes `py_func`, for which nothing is compiled.
"""

import math

import numpy as np
from numpy.typing import NDArray

from twin.kernel.compiled.function import carray, njit
from twin.kernel.compiled.native import entry
from twin.robot.mechanism.geometry import AXIS, OUTWARD, Geometry, skeleton

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


BASE = "base"
LEGS = (1, 2, 3)
LINKS = tuple(f"link_{leg}" for leg in LEGS)
RODS = tuple(f"rod_{leg}_{side}" for leg in LEGS for side in ("minus", "plus"))
PLATFORM = "platform"
SURFACE = "surface"
FRAMES = (*LINKS, *RODS, PLATFORM, SURFACE)
"""In the order of `poses`."""
HALF_WIDTH = 0.012
"""Of the parallelograms (m), for drawing only: it does not enter Eq. 3-6."""

POSE = 7
"""Numbers of a position and a quaternion."""

# angle phi_i of each leg about z
PHI = np.arctan2(OUTWARD[:, 1], OUTWARD[:, 0])


def poses(
    geometry: Geometry, theta_l: NDArray[np.float64], p_B: NDArray[np.float64], surface_B: NDArray[np.float64]
) -> NDArray[np.float64]:
    """Position (m) and unit quaternion (x, y, z, w) of each of `FRAMES` in B, (n, len(FRAMES), POSE).

    Args:
        geometry: lengths of Fig. 2.
        theta_l: angles of the proximal links in rad, (n, 3).
        p_B: platform position in m, (n, 3).
        surface_B: pose of the surface, (n, POSE).

    Raises:
        InputRefused: theta_l or p_B is not finite or not of shape (n, 3).
    """
    joints = skeleton(geometry, theta_l, p_B)
    found = np.empty((len(p_B), len(FRAMES), POSE))
    _put_poses(*map(np.ascontiguousarray, (*joints, theta_l, p_B, surface_B)), len(p_B), found)
    return found


@njit(cache=True)
def put_pose(to, at, x, y, z, q):
    """Put position and quaternion where numbers of `to` begin, `at` of them, and say where the next begin."""
    to[at], to[at + 1], to[at + 2] = x, y, z
    to[at + 3], to[at + 4], to[at + 5], to[at + 6] = q
    return at + POSE


@entry("nothing", "doubles", "doubles", "doubles", "doubles", "doubles", "doubles", "int", "doubles")
def _put_poses(base_joints, ends, platform_joints, theta_l, p_B, surface_B, count, found):
    B, to = carray(base_joints, (3, 3)), carray(found, count * len(FRAMES) * POSE)
    A, P = carray(ends, (count, 3, 3)), carray(platform_joints, (count, 3, 3))
    angle, p, surface = carray(theta_l, (count, 3)), carray(p_B, (count, 3)), carray(surface_B, (count, POSE))
    at = 0
    for i in range(count):
        for leg in range(3):
            at = put_pose(to, at, B[leg, 0], B[leg, 1], B[leg, 2], leaning(PHI[leg], angle[i, leg]))
        for leg in range(3):
            x, y, z = A[i, leg]
            q = _rod_turn(leg, P[i, leg, 0] - x, P[i, leg, 1] - y, P[i, leg, 2] - z)
            for side in (-HALF_WIDTH, HALF_WIDTH):
                at = put_pose(to, at, x + side * AXIS[leg, 0], y + side * AXIS[leg, 1], z + side * AXIS[leg, 2], q)
        at = put_pose(to, at, p[i, 0], p[i, 1], p[i, 2], IDENTITY)
        for k in range(POSE):
            to[at + k] = surface[i, k]
        at += POSE


@njit(cache=True)
def _rod_turn(leg, x, y, z):
    """A turn that takes e_x to the rod A_iP_i, (x, y, z), and leaves e_z in the plane of the link."""
    outward = x * OUTWARD[leg, 0] + y * OUTWARD[leg, 1]
    sideways = x * AXIS[leg, 0] + y * AXIS[leg, 1]
    swing = turn(Z, math.atan2(sideways, math.hypot(outward, z)))
    return product(leaning(PHI[leg], math.atan2(-z, outward)), swing)
