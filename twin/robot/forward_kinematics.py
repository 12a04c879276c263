"""Forward position kinematics, Eq. 13-17: joint angles to platform position.

The platform centre is the point at distance l_b from the three virtual sphere centres A_iv (Eq. 15, 16).
Eq. 17 eliminates x and z in favour of y, which divides by zero where theta_1 = theta_2 = theta_3: the home
pose. Here the point is found without choosing a coordinate: it lies on the normal of the centres' triangle
through its circumcentre. Of the two intersections, mirrored through the triangle's plane, the robot is at the
one below; "below" follows the triangle if it turns over, because the robot cannot pass through its plane, a
parallel singularity.
"""

import math

import numpy as np
from numpy.typing import ArrayLike, NDArray

from twin.compiled.function import carray, njit
from twin.compiled.native import entry
from twin.errors import Unreachable
from twin.robot.geometry import LEG_COS, LEG_SIN, Geometry
from twin.robot.triples import place, triples


@njit(cache=True)
def sphere_centre(geometry, leg, theta):
    """Virtual sphere centre A_iv of leg i in the base frame in m, Eq. 14-15: ``(x, y, z)``."""
    outward = geometry.a - geometry.b + geometry.l_a * math.cos(theta)
    return outward * LEG_COS[leg], outward * LEG_SIN[leg], -geometry.l_a * math.sin(theta)


@njit(cache=True)
def circumcentre(geometry, theta_1, theta_2, theta_3):
    """Circumcentre, squared circumradius and unit normal of the three sphere centres.

    With A and B the edges from centre 1 to centres 2 and 3 and n = A x B, the circumcentre lies at
    ((A.A) B - (B.B) A) x n / (2 n.n) from centre 1. n points up while the arms point outward.

    Returns:
        ``(x, y, z, R2, n_x, n_y, n_z)``, lengths in m; R2 is infinite for centres on one line.
    """
    x_1, y_1, z_1 = sphere_centre(geometry, 0, theta_1)
    x_2, y_2, z_2 = sphere_centre(geometry, 1, theta_2)
    x_3, y_3, z_3 = sphere_centre(geometry, 2, theta_3)
    A_x, A_y, A_z = x_2 - x_1, y_2 - y_1, z_2 - z_1
    B_x, B_y, B_z = x_3 - x_1, y_3 - y_1, z_3 - z_1
    n_x, n_y, n_z = A_y * B_z - A_z * B_y, A_z * B_x - A_x * B_z, A_x * B_y - A_y * B_x
    n2 = n_x * n_x + n_y * n_y + n_z * n_z
    if n2 == 0.0:
        return math.nan, math.nan, math.nan, math.inf, math.nan, math.nan, math.nan
    A2 = A_x * A_x + A_y * A_y + A_z * A_z
    B2 = B_x * B_x + B_y * B_y + B_z * B_z
    c_x, c_y, c_z = A2 * B_x - B2 * A_x, A2 * B_y - B2 * A_y, A2 * B_z - B2 * A_z
    r_x = (c_y * n_z - c_z * n_y) / (2.0 * n2)
    r_y = (c_z * n_x - c_x * n_z) / (2.0 * n2)
    r_z = (c_x * n_y - c_y * n_x) / (2.0 * n2)
    n = math.sqrt(n2)
    R2 = r_x * r_x + r_y * r_y + r_z * r_z
    return x_1 + r_x, y_1 + r_y, z_1 + r_z, R2, n_x / n, n_y / n, n_z / n


@njit(cache=True)
def platform_position(geometry, theta_1, theta_2, theta_3):
    """Platform position p_B in m, Eq. 16: ``(x, y, z)``.

    Of the two intersections the one against the normal of the sphere centres, like the home pose; NaN
    where the three spheres of radius l_b do not meet.

    Args:
        geometry: a :class:`~twin.robot.geometry.Geometry` or a record with its attributes.
        theta_1, theta_2, theta_3: joint angles theta_l in rad.
    """
    x, y, z, R2, n_x, n_y, n_z = circumcentre(geometry, theta_1, theta_2, theta_3)
    h2 = geometry.l_b * geometry.l_b - R2
    if h2 < 0.0:
        return math.nan, math.nan, math.nan
    h = math.sqrt(h2)
    return x - h * n_x, y - h * n_y, z - h * n_z


@entry("nothing", "doubles", "doubles", "int", "doubles")
def _positions(lengths, angles, poses, positions):
    geometry = Geometry(lengths[0], lengths[1], lengths[2], lengths[3])
    theta_l, p_B = carray(angles, (poses, 3)), carray(positions, (poses, 3))
    for row in range(poses):
        p_B[row, 0], p_B[row, 1], p_B[row, 2] = platform_position(
            geometry, theta_l[row, 0], theta_l[row, 1], theta_l[row, 2]
        )


def position(geometry: Geometry, theta_l: ArrayLike) -> NDArray[np.float64]:
    """Platform position p_B in m for given joint angles, Eq. 13-17 in corrected form.

    Args:
        geometry: lengths of Fig. 2.
        theta_l: angles of the three proximal links in rad, shape (..., 3).

    Returns:
        Positions of O_P in the base frame, shape (..., 3).

    Raises:
        Unreachable: the distal links cannot meet; names the first such pose, leg 0 because all take part.
        InputRefused: theta_l is not finite or not of shape (..., 3).
    """
    theta_l = triples(theta_l, "theta_l")
    p_B = np.empty((theta_l.size // 3, 3))
    _positions(np.array(geometry, dtype=float), np.ascontiguousarray(theta_l), len(p_B), p_B)
    bad = np.isnan(p_B[:, 0])
    if bad.any():
        row = int(np.argmax(bad))
        raise _no_meeting(geometry, theta_l.reshape(-1, 3)[row], f"theta_l{place(theta_l, row)}")
    return p_B.reshape(theta_l.shape)


def _no_meeting(geometry: Geometry, theta_l: NDArray[np.float64], name: str) -> Unreachable:
    R = math.sqrt(circumcentre(geometry, *theta_l)[3])
    pose = ", ".join(f"{math.degrees(value):.2f}" for value in theta_l)
    return Unreachable(
        f"{name} = ({pose}) deg cannot be closed: the distal links would need l_b = {1e3 * R:.1f} mm to "
        f"meet, have {1e3 * geometry.l_b:.1f} mm; bring the joint angles closer together",
        leg=0,
        pose=tuple(theta_l.tolist()),
        excess=R - geometry.l_b,
    )
