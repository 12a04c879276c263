"""Workspace of the robot: reach, angles of the ball joints, and collisions of rods and links.

The two rods of a pair turn freely about the common axis of their ball joints; the socket limits the inclination of the
rod from the plane across that axis, asin(w/l_b) with w the sideways part of A_iP_i. Rods and links are round bars
between the joints; the rods of a pair are half their spacing to either side of A_iP_i.
"""

import math
from typing import NamedTuple

import numpy as np
from numpy.typing import ArrayLike, NDArray

from twin.kernel.compiled.function import carray, njit
from twin.kernel.compiled.native import entry
from twin.robot.mechanism.geometry import AXIS, Geometry, skeleton, triples
from twin.robot.mechanism.kinematics import circumcentre, joint_angles, leg_angle, position
from twin.robot.mechanism.unreachable import Unreachable

BARS_PER_LEG = 3
"""Bars of a leg: its link and the two rods of its pair."""
HOME_ANGLE = math.radians(20.0)
"""Angle (rad) of all proximal links below the horizontal in the home pose; the paper's robot presses at this angle."""


@njit(cache=True)
def _reaches(geometry, x, y, z):
    theta_1 = leg_angle(geometry, 0, x, y, z)
    theta_2 = leg_angle(geometry, 1, x, y, z)
    theta_3 = leg_angle(geometry, 2, x, y, z)
    c_x, c_y, c_z, _, n_x, n_y, n_z = circumcentre(geometry, theta_1, theta_2, theta_3)
    # false where an angle is NaN, so also where a leg does not reach
    return (x - c_x) * n_x + (y - c_y) * n_y + (z - c_z) * n_z <= 0.0


@entry("nothing", "doubles", "doubles", "int", "bytes")
def _reachable(lengths, positions, poses, reachable):
    geometry = Geometry(lengths[0], lengths[1], lengths[2], lengths[3])
    p_B = carray(positions, (poses, 3))
    for row in range(poses):
        x, y, z = p_B[row]
        reachable[row] = _reaches(geometry, x, y, z)


def is_reachable(geometry: Geometry, p_B: ArrayLike) -> NDArray[np.bool_]:
    """Whether all legs reach with the knees outward, on the home pose's side of the parallel singularity.

    Beyond it the joint angles exist too, but the robot, which cannot cross, has another pose at these angles.

    Args:
        geometry: lengths of Fig. 2.
        p_B: platform positions in the base frame in m, shape (..., 3).

    Returns:
        One truth value per pose, shape (...).

    Raises:
        InputRefused: p_B is not finite or not of shape (..., 3).
    """
    p_B = triples(p_B, "p_B")
    reachable = np.empty(p_B.shape[:-1], dtype=np.bool_)
    _reachable(np.array(geometry, dtype=float), np.ascontiguousarray(p_B), reachable.size, reachable)
    return reachable


def home_height(geometry: Geometry) -> float:
    """Return the z (m) of the home pose: the platform on the axis, all proximal links at `HOME_ANGLE` (Eq. 13-17).

    Raises:
        Unreachable: the distal links do not meet there, or only beyond the parallel singularity.
    """
    pose, excess = (HOME_ANGLE,) * 3, 0.0
    try:
        p_B = position(geometry, pose)
        if is_reachable(geometry, p_B):
            return float(p_B[2])
    except Unreachable as problem:
        excess = problem.excess
    needed = f"l_b > {1e3 * (geometry.l_b + excess):.1f} mm" if excess else "b below a + l_a"
    raise Unreachable(
        f"no home pose: the legs do not meet with the proximal links {math.degrees(HOME_ANGLE):g} deg below the "
        f"horizontal; expected {needed}, or change the other lengths", 0, pose, excess
    )  # fmt: skip


class Bars(NamedTuple):
    """Sizes of the bars of a leg (m): diameters, and the distance between the middles of the two rods of a pair."""

    link_diameter: float
    rod_diameter: float
    rod_spacing: float


def ball_joint_angles(geometry: Geometry, p_B: NDArray[np.float64]) -> NDArray[np.float64]:
    """Inclination in the ball joints of each leg (rad, >= 0), equal at both ends of its rods, shape (..., 3).

    Args:
        geometry: lengths of Fig. 2.
        p_B: platform positions in the base frame in m, shape (..., 3), within reach.
    """
    return np.arcsin(np.minimum(np.abs(p_B @ AXIS.T) / geometry.l_b, 1.0))


def clearances(
    geometry: Geometry, bars: Bars, p_B: NDArray[np.float64]
) -> tuple[NDArray[np.float64], NDArray[np.int64]]:
    """Clearance between bars of different legs (m, negative in collision), (n,), and the nearest pair.

    A bar is numbered 3 leg + kind, with the legs from 0, kind 0 the link and 1 and 2 its rods, (n, 2).

    Args:
        geometry: lengths of Fig. 2.
        bars: their sizes.
        p_B: platform positions in the base frame in m, (n, 3), within reach.

    Raises:
        Unreachable: one of `p_B` is out of reach.
    """
    joints = skeleton(geometry, joint_angles(geometry, p_B), p_B)
    aside = 0.5 * bars.rod_spacing * AXIS
    ends = np.empty((len(p_B), 3, BARS_PER_LEG, 2, 3))
    ends[:, :, 0, 0], ends[:, :, 0, 1] = joints.B, joints.A
    for kind, way in ((1, -aside), (2, aside)):
        ends[:, :, kind, 0], ends[:, :, kind, 1] = joints.A + way, joints.P + way
    radii = 0.5 * np.array([bars.link_diameter, bars.rod_diameter, bars.rod_diameter])
    gaps, pairs = np.full(len(p_B), np.inf), np.zeros((len(p_B), 2), dtype=np.int64)
    _nearest(ends, radii, len(p_B), gaps, pairs)
    return gaps, pairs


@entry("nothing", "doubles", "doubles", "int", "doubles", "integers")
def _nearest(bars, radius, poses, gap_of, pair_of):
    ends, radii = carray(bars, (poses, 3 * BARS_PER_LEG, 2, 3)), carray(radius, BARS_PER_LEG)
    gaps, pairs = carray(gap_of, poses), carray(pair_of, (poses, 2))
    for pose in range(poses):
        for one in range(2 * BARS_PER_LEG):
            for other in range(BARS_PER_LEG * (one // BARS_PER_LEG + 1), 3 * BARS_PER_LEG):
                apart = segment_distance(
                    ends[pose, one, 0], ends[pose, one, 1], ends[pose, other, 0], ends[pose, other, 1]
                )
                gap = apart - radii[one % BARS_PER_LEG] - radii[other % BARS_PER_LEG]
                if gap < gaps[pose]:
                    gaps[pose] = gap
                    pairs[pose, 0], pairs[pose, 1] = one, other


@njit(cache=True, inline="always")
def _difference(a, b):
    return b[0] - a[0], b[1] - a[1], b[2] - a[2]


@njit(cache=True, inline="always")
def _dot(a, b):
    return a[0] * b[0] + a[1] * b[1] + a[2] * b[2]


@njit(cache=True)
def segment_distance(a, b, c, d):
    """Distance between the segments a-b and c-d (3,), neither of them a point.

    The algorithm is in Ericson (2005), Real-Time Collision Detection, 5.1.9.
    """
    # triples, as an array for each difference would take ten times as long as all of the arithmetic
    ab, cd, ca = _difference(a, b), _difference(c, d), _difference(c, a)
    aa, dd, ad = _dot(ab, ab), _dot(cd, cd), _dot(ab, cd)
    f, e = _dot(cd, ca), _dot(ab, ca)
    across = aa * dd - ad * ad
    # parallel segments have the same distance everywhere
    s = min(max((ad * f - e * dd) / across, 0.0), 1.0) if across > 1e-12 * aa * dd else 0.0
    t = (ad * s + f) / dd
    if t < 0.0:
        t, s = 0.0, min(max(-e / aa, 0.0), 1.0)
    elif t > 1.0:
        t, s = 1.0, min(max((ad - e) / aa, 0.0), 1.0)
    apart = ca[0] + s * ab[0] - t * cd[0], ca[1] + s * ab[1] - t * cd[1], ca[2] + s * ab[2] - t * cd[2]
    return np.sqrt(_dot(apart, apart))
