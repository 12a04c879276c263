"""Kinematics, Eq. 7-17: joint angles, platform position, Jacobian, singularities.

The inverse position kinematics, Eq. 7-12, give joint angles from the platform position. Eq. 7 for one leg is
E cos(theta) + F sin(theta) + G = 0 (Eq. 8) with the coefficients the paper leaves out,

    E = -2 l_a u,  F = 2 l_a p_z,  G = u^2 + w^2 + p_z^2 + l_a^2 - l_b^2,

u and w from :func:`twin.robot.mechanism.geometry.leg_coordinates`. With D = E^2 + F^2 - G^2 the roots of Eq. 10 are
t = (-F -+ sqrt(D))/(G - E) = (G + E)/(-F +- sqrt(D)). Eq. 11 prints the first form, which is 0/0 for the
outward knee where G = E; the second form divides by a sum of two positive numbers, because p_z < 0 makes
F < 0. For the inward knee the first form is the one without cancellation.

The forward position kinematics, Eq. 13-17, give the platform position from joint angles. The platform centre is the
point at distance l_b from the three virtual sphere centres A_iv (Eq. 15, 16). Eq. 17 eliminates x and z in favour of y,
which divides by zero where theta_1 = theta_2 = theta_3: the home pose. Here the point is found without choosing a
coordinate: it lies on the normal of the centres' triangle through its circumcentre. There are two intersections,
mirrored through the triangle's plane, and the robot is at the one below; "below" follows the triangle if it turns over,
because the robot cannot pass through its plane, a parallel singularity.

The Jacobian is J = d theta_l / d p_B. The time derivative of Eq. 7, s_i . (v - d_i dtheta_i/dt) = 0 with s_i = A_iP_i,
d_i = dA_i/dtheta_i and v = dp_B/dt, gives row i of J as s_i^T / (s_i . d_i). The denominator is +sqrt(D)/2 with the
knee outward (D of Eq. 11), -sqrt(D)/2 with the knee inward; where it vanishes the leg is stretched or folded: the
serial singularity, which is the edge of the workspace.

The distance to singularities is measured from the Jacobian without units. With e_i = A_iP_i / l_b the Jacobian is
J = diag(1/(l_a sine_i)) [e_1 e_2 e_3]^T, so det J^-1 = l_a^3 sine_1 sine_2 sine_3 / det[e_1 e_2 e_3]. The numerator
vanishes at a serial singularity. The denominator vanishes at a parallel singularity: the distal links lie in one plane
and the platform yields along its normal although the joints are held.
"""

import math
from typing import Literal

import numpy as np
from numpy.typing import ArrayLike, NDArray

from twin.kernel.compiled.function import carray, njit
from twin.kernel.compiled.native import entry
from twin.kernel.errors import InputRefused
from twin.robot.mechanism.geometry import LEG_COS, LEG_SIN, Geometry, distal_link, leg_coordinates, place, triples
from twin.robot.mechanism.unreachable import Unreachable

# At the edge of the workspace both measures come from angles that are roots of D (Eq. 11). D is rounded to
# about 1e-16 (l_a l_b)^2, its root to 1e-8: ten times that is the smallest value known not to be zero.
SMALLEST_KNOWN_NONZERO = 1e-7


class SingularPose(InputRefused, ValueError):
    """Error for a singular pose, where torques and forces, or joint and platform speeds, do not determine each other.

    Attributes:
        leg: 1, 2 or 3, the leg that is stretched or folded; 0 where the three distal links lie in one plane.
        pose: platform position in m.
    """

    def __init__(self, message: str, leg: int, pose: tuple[float, ...]):
        super().__init__(message)
        self.leg = leg
        self.pose = pose


def transmission_sines(geometry: Geometry, J: NDArray[np.float64]) -> NDArray[np.float64]:
    """Per leg, the share of its path speed that A_i passes along the distal link: 1/(l_a |row i of J|).

    Equal to sqrt(D) / (2 l_a l_b) with D of Eq. 11. For a leg that stands in its own plane (w = 0) it is the
    sine of the angle between its two links: 1 with the links at right angles, 0 stretched or folded.

    Args:
        geometry: lengths of Fig. 2.
        J: Jacobians d theta_l / d p_B in rad/m, shape (..., 3, 3).

    Returns:
        Measures of the three legs, shape (..., 3).
    """
    return 1.0 / (geometry.l_a * np.linalg.norm(J, axis=-1))


def distal_volume(J: NDArray[np.float64]) -> NDArray[np.float64]:
    """Triple product e_1 . (e_2 x e_3) of the distal links' directions: 0 at the parallel singularity.

    Args:
        J: Jacobians d theta_l / d p_B in rad/m with the knees outward, shape (..., 3, 3).

    Returns:
        Volumes of the spanned parallelepiped, shape (...), at most 1 in magnitude, negative on the home
        pose's side of the parallel singularity.
    """
    return np.linalg.det(J / np.linalg.norm(J, axis=-1, keepdims=True))


def refuse_serial_singularity(geometry: Geometry, J: NDArray[np.float64], p_B: NDArray[np.float64]) -> None:
    """Refuse poses with a stretched or folded leg.

    Args:
        geometry: lengths of Fig. 2.
        J: Jacobians in rad/m at the poses, shape (..., 3, 3); rows may be infinite.
        p_B: the poses in m, shape (..., 3), for the message.

    Raises:
        SingularPose: names the first pose and leg whose transmission sine is 0 to rounding.
    """
    known = transmission_sines(geometry, J).reshape(-1, 3) >= SMALLEST_KNOWN_NONZERO
    if not known.all():
        row, leg = divmod(int(np.argmin(known)), 3)
        raise _singular(
            p_B,
            row,
            f"leg {leg + 1} is stretched or folded, so its torque sets no force; stay inside the workspace",
            leg + 1,
        )


def refuse_parallel_singularity(J: NDArray[np.float64], p_B: NDArray[np.float64]) -> None:
    """Refuse poses whose three distal links lie in one plane.

    Args:
        J: Jacobians in rad/m at the poses, shape (..., 3, 3).
        p_B: the poses in m, shape (..., 3), for the message.

    Raises:
        SingularPose: names the first pose whose distal volume is 0 to rounding.
    """
    known = np.abs(distal_volume(J)).reshape(-1) >= SMALLEST_KNOWN_NONZERO
    if not known.all():
        raise _singular(
            p_B,
            int(np.argmin(known)),
            "the distal links lie in one plane, so no torque holds a force along its normal; move away",
            0,
        )


def _singular(p_B: NDArray[np.float64], row: int, why: str, leg: int) -> SingularPose:
    pose = p_B.reshape(-1, 3)[row].tolist()
    written = ", ".join(f"{1e3 * value:.1f}" for value in pose)
    return SingularPose(f"p_B{place(p_B, row)} = ({written}) mm is singular: {why}", leg, tuple(pose))


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
        geometry: a :class:`~twin.robot.mechanism.geometry.Geometry` or a record with its attributes.
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
    """Return the joint angle theta_i in (0, 2 pi) rad of a leg with the knee inward (Eq. 10); NaN out of reach.

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
    """Shortest and longest possible distal link in m of leg i for a platform at p_B, shape (2, ...).

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

    The solution is the intersection against the normal of the sphere centres, like the home pose; NaN where the three
    spheres of radius l_b do not meet.

    Args:
        geometry: a :class:`~twin.robot.mechanism.geometry.Geometry` or a record with its attributes.
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


# numpy's division: at a serial singularity the row is infinite, it does not raise inside the compiled loop
@njit(cache=True, error_model="numpy")
def jacobian_row(geometry, leg, theta, x, y, z):
    """Row i of J = d theta_l / d p_B in rad/m: ``(j_x, j_y, j_z)``.

    Args:
        geometry: a :class:`~twin.robot.mechanism.geometry.Geometry` or a record with its attributes.
        leg: 0, 1 or 2.
        theta: joint angle of this leg in rad, either branch, consistent with the position.
        x, y, z: platform position in the base frame in m.
    """
    cos_theta, sin_theta = np.cos(theta), np.sin(theta)
    s_x, s_y, s_z = distal_link(geometry, leg, cos_theta, sin_theta, x, y, z)
    s_d = -geometry.l_a * ((s_x * LEG_COS[leg] + s_y * LEG_SIN[leg]) * sin_theta + s_z * cos_theta)
    return s_x / s_d, s_y / s_d, s_z / s_d


@entry("nothing", "doubles", "doubles", "doubles", "int", "doubles")
def _rows(lengths, angles, positions, poses, rows):
    geometry = Geometry(lengths[0], lengths[1], lengths[2], lengths[3])
    theta_l, p_B, J = carray(angles, (poses, 3)), carray(positions, (poses, 3)), carray(rows, (poses, 3, 3))
    for n in range(poses):
        x, y, z = p_B[n]
        for leg in range(3):
            J[n, leg, 0], J[n, leg, 1], J[n, leg, 2] = jacobian_row(geometry, leg, theta_l[n, leg], x, y, z)


def jacobian_rows(geometry: Geometry, theta_l: NDArray[np.float64], p_B: NDArray[np.float64]) -> NDArray[np.float64]:
    """J in rad/m, shape (n, 3, 3), for n poses in m and the joint angles of these poses, shape (n, 3)."""
    J = np.empty((len(p_B), 3, 3))
    _rows(np.array(geometry), np.ascontiguousarray(theta_l), np.ascontiguousarray(p_B), len(p_B), J)
    return J


def jacobian(geometry: Geometry, p_B: ArrayLike) -> NDArray[np.float64]:
    """J = d theta_l / d p_B in rad/m with the knees outward; row i belongs to leg i.

    Args:
        geometry: lengths of Fig. 2.
        p_B: platform positions in the base frame in m, shape (..., 3).

    Returns:
        Jacobians, shape (..., 3, 3).

    Raises:
        Unreachable: a pose has no joint angles.
        SingularPose: a leg is stretched or folded, so its row is infinite.
        InputRefused: p_B is not finite or not of shape (..., 3).
    """
    p_B = triples(p_B, "p_B")
    theta_l = joint_angles(geometry, p_B)
    J = jacobian_rows(geometry, theta_l.reshape(-1, 3), p_B.reshape(-1, 3)).reshape(*p_B.shape, 3)
    refuse_serial_singularity(geometry, J, p_B)
    return J
