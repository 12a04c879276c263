"""Inverse position kinematics, Eq. 7-12: platform position to joint angles.

Eq. 7 for one leg is E cos(theta) + F sin(theta) + G = 0 (Eq. 8) with the coefficients the paper leaves out,

    E = -2 l_a u,  F = 2 l_a p_z,  G = u^2 + w^2 + p_z^2 + l_a^2 - l_b^2,

u and w from :func:`twin.robot.geometry.leg_coordinates`. With D = E^2 + F^2 - G^2 the roots of Eq. 10 are
t = (-F -+ sqrt(D))/(G - E) = (G + E)/(-F +- sqrt(D)). Eq. 11 prints the first form, which is 0/0 for the
outward knee where G = E; the second form divides by a sum of two positive numbers, because p_z < 0 makes
F < 0. For the inward knee the first form is the one without cancellation.
"""

import math
from typing import Literal

import numpy as np
from numpy.typing import ArrayLike, NDArray

from twin.compiled.function import carray, njit
from twin.compiled.native import entry
from twin.errors import InputRefused, Unreachable
from twin.robot.geometry import Geometry, leg_coordinates
from twin.robot.triples import place, triples


@njit(cache=True)
def loop_coefficients(geometry, leg, x, y, z):
    """E, F, G of Eq. 8 in m^2 for the platform at (x, y, z) in m: ``(E, F, G)``."""
    u, w = leg_coordinates(geometry, leg, x, y)
    l_a, l_b = geometry.l_a, geometry.l_b
    return -2.0 * l_a * u, 2.0 * l_a * z, u * u + w * w + z * z + l_a * l_a - l_b * l_b


@njit(cache=True)
def leg_angle(geometry, leg, x, y, z):
    """Joint angle theta_i in (-pi, pi) rad of leg i, knee outward, Eq. 10-12; NaN out of reach (D < 0).

    Args:
        geometry: a :class:`~twin.robot.geometry.Geometry` or a record with its attributes.
        leg: 0, 1 or 2.
        x, y, z: platform position in the base frame in m, z < 0.
    """
    E, F, G = loop_coefficients(geometry, leg, x, y, z)
    D = E * E + F * F - G * G
    if D < 0.0:
        return math.nan
    return 2.0 * math.atan2(G + E, math.sqrt(D) - F)


@njit(cache=True)
def leg_angle_inward(geometry, leg, x, y, z):
    """The other root of Eq. 10: theta_i in (0, 2 pi) rad with the knee inward; NaN out of reach.

    The range leaves the angle continuous through pi, where the proximal link points straight inward.
    Arguments as :func:`leg_angle`.
    """
    E, F, G = loop_coefficients(geometry, leg, x, y, z)
    D = E * E + F * F - G * G
    if D < 0.0:
        return math.nan
    return 2.0 * math.atan2(math.sqrt(D) - F, G - E)


@entry("nothing", "doubles", "doubles", "int", "int", "doubles")
def _angles(lengths, positions, poses, inward, angles):
    geometry = Geometry(lengths[0], lengths[1], lengths[2], lengths[3])
    p_B, theta_l = carray(positions, (poses, 3)), carray(angles, (poses, 3))
    for row in range(poses):
        x, y, z = p_B[row]
        for leg in range(3):
            if inward:
                theta_l[row, leg] = leg_angle_inward(geometry, leg, x, y, z)
            else:
                theta_l[row, leg] = leg_angle(geometry, leg, x, y, z)


def joint_angles(
    geometry: Geometry, p_B: ArrayLike, branch: Literal["outward", "inward"] = "outward"
) -> NDArray[np.float64]:
    """Joint angles theta_l in rad that put the platform at p_B, Eq. 7-12.

    Args:
        geometry: lengths of Fig. 2.
        p_B: platform positions in the base frame in m, shape (..., 3), z < 0.
        branch: which of the two solutions the paper notes under Eq. 12: knees outward or inward, on all legs.

    Returns:
        Angles of the three legs, shape (..., 3).

    Raises:
        Unreachable: a leg cannot reach; names the first such pose, the leg and the missing length.
        InputRefused: p_B is not finite or not of shape (..., 3), or there is no such branch.
    """
    if branch not in ("outward", "inward"):
        raise InputRefused(f"branch is {branch!r}; expected 'outward' or 'inward'")
    p_B = triples(p_B, "p_B")
    rows = np.ascontiguousarray(p_B.reshape(-1, 3))
    theta_l = np.empty_like(rows)
    _angles(np.array(geometry), rows, len(rows), branch == "inward", theta_l)
    bad = np.isnan(theta_l)
    if bad.any():
        row, leg = divmod(int(np.argmax(bad)), 3)
        raise _out_of_reach(geometry, leg, p_B.reshape(-1, 3)[row], f"p_B{place(p_B, row)}")
    return theta_l.reshape(p_B.shape)


def distal_length_range(geometry: Geometry, leg: int, p_B: ArrayLike) -> NDArray[np.float64]:
    """Shortest and longest distal link in m with which leg i could hold the platform at p_B, shape (2, ...).

    A_i runs on a circle of radius l_a about B_i, P_i stands rho = sqrt(u^2 + p_z^2) from B_i in that circle's
    plane and w out of it, so its distances to the circle span sqrt((rho -+ l_a)^2 + w^2). In these terms the
    discriminant of Eq. 11 is D = (longest^2 - l_b^2)(l_b^2 - shortest^2): D = 0 is the edge of the workspace.

    Args:
        geometry: lengths of Fig. 2.
        leg: 0, 1 or 2.
        p_B: platform positions in m, shape (..., 3).
    """
    x, y, z = np.moveaxis(np.asarray(p_B, dtype=np.float64), -1, 0)
    u, w = leg_coordinates(geometry, leg, x, y)
    rho = np.hypot(u, z)
    return np.stack((np.hypot(rho - geometry.l_a, w), np.hypot(rho + geometry.l_a, w)))


def _out_of_reach(geometry: Geometry, leg: int, p_B: NDArray[np.float64], name: str) -> Unreachable:
    shortest, longest = distal_length_range(geometry, leg, p_B)
    needed = shortest if shortest - geometry.l_b > geometry.l_b - longest else longest
    pose = ", ".join(f"{1e3 * value:.1f}" for value in p_B)
    return Unreachable(
        f"{name} = ({pose}) mm is out of reach: leg {leg + 1} would need l_b = {1e3 * needed:.1f} mm, "
        f"has {1e3 * geometry.l_b:.1f} mm; move the pose into the workspace",
        leg=leg + 1,
        pose=tuple(p_B.tolist()),
        excess=abs(float(needed) - geometry.l_b),
    )
