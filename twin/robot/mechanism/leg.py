"""A leg without trigonometry: Eq. 7 solved for the knee as a point instead of for the angle.

In the leg's own frame (outward, sideways, up from B_i) the platform joint P_i is at (u, w, z) and the knee A_i at
(k_r, 0, k_z) = l_a (cos theta, 0, -sin theta). |A_iP_i| = l_b (Eq. 7) and |B_iA_i| = l_a give

    k_r u + k_z z = l_a g,   g = (u^2 + w^2 + z^2 + l_a^2 - l_b^2) / (2 l_a),

a line across the knee's circle; of the two points where they meet the outward one is

    (k_r, k_z) = l_a / (u^2 + z^2) (g (u, z) + q (-z, u)),   q = sqrt(u^2 + z^2 - g^2) = sqrt(D) / (2 l_a)

with D of Eq. 11. d = dA_i/d theta is (k_z, 0, -k_r), and the Jacobian's denominator is s . d = l_a q.
"""

import math

import numpy as np

from twin.kernel.compiled.function import njit, three, with_lane
from twin.robot.mechanism.geometry import leg_coordinates

SMALL = 1.0 / 64.0
"""Sine of the largest turn from an anchor for which the arc sine is a series: its first missing term is 2e-20."""

NO_ANCHOR = np.full((3, 3), np.nan)
"""Anchors that no pose is near."""


# numpy's division here and below: at a singularity there has to be infinity or NaN, because an exception of compiled
# code that the master calls by address is lost
@njit(cache=True, error_model="numpy", forceinline=True)
def leg_vectors(geometry, leg, x, y, z):
    """Knee and distal link of a leg in its own frame, knee outward: ``(k_r, k_z, r, w, h, q)``, all m.

    (k_r, 0, k_z) is the proximal link B_iA_i, (r, w, h) the distal link A_iP_i, and s . d = l_a q. NaN out of reach.

    Args:
        geometry: a :class:`~twin.robot.mechanism.geometry.Geometry` or a record with its attributes.
        leg: 0, 1 or 2.
        x, y, z: platform position in the base frame in m, z < 0.
    """
    u, w = leg_coordinates(geometry, leg, x, y)
    return links(geometry, u, w, z)


@njit(cache=True, error_model="numpy", forceinline=True)
def links(geometry, u, w, z):
    """As `leg_vectors`, of a leg whose P_i stands at (u, w, z), or of three, u and w being `compiled.lanes` then."""
    l_a, l_b = geometry.l_a, geometry.l_b
    square = u * u + z * z
    g = (square + w * w + (l_a * l_a - l_b * l_b)) * (0.5 / l_a)
    q = math.sqrt(square - g * g)
    share = l_a / square
    k_r, k_z = share * (g * u - q * z), share * (g * z + q * u)
    return k_r, k_z, u - k_r, w, z - k_z, q


@njit(cache=True, error_model="numpy", forceinline=True)
def leg_motion(geometry, k_r, k_z, r, w, h, q, v_r, v_w, v_z):
    """How a joint moves with the platform, in the leg's own frame: ``(j_r, j_w, j_z, omega_l, kappa)``.

    (j_r, j_w, j_z) = s / (s . d) is the row of J = d theta_l / d p in rad/m, omega_l the joint's speed in rad/s, and
    kappa its acceleration in rad/s^2 while the platform moves at constant velocity, (dJ/dt) v. The second time
    derivative of Eq. 7 at dv/dt = 0, with d' = d^2 A_i / d theta^2 = -(k_r, 0, k_z), is

        (v - d omega) . (v - d omega) - (s . d') omega^2 - (s . d) kappa = 0.

    Args:
        geometry, k_r, k_z, r, w, h, q: of :func:`leg_vectors`; of three legs they are `compiled.lanes`, and so are
        v_r, v_w, v_z: velocity of the platform in m/s.
    """
    share = 1.0 / geometry.l_a / q
    j_r, j_w, j_z = r * share, w * share, h * share
    omega_l = j_r * v_r + j_w * v_w + j_z * v_z
    e_r, e_z = v_r - k_z * omega_l, v_z + k_r * omega_l
    kappa = (e_r * e_r + v_w * v_w + e_z * e_z + (r * k_r + h * k_z) * (omega_l * omega_l)) * share
    return j_r, j_w, j_z, omega_l, kappa


@njit(cache=True, error_model="numpy", forceinline=True)
def angle_near(anchors, leg, k_r, k_z):
    """Joint angle in rad of the leg whose knee is at (k_r, k_z); fast if its anchor is near.

    Args:
        anchors: an angle of each leg, and its cosine and sine divided by l_a, (3, 3); see :func:`move_anchor`.
        leg: 0, 1 or 2.
        k_r, k_z: of :func:`leg_vectors`.
    """
    turned = _turned(anchors[leg, 1], anchors[leg, 2], k_r, k_z)
    if not abs(turned) < SMALL:
        return math.atan2(-k_z, k_r)
    return anchors[leg, 0] + _arc_sine(turned)


@njit(cache=True, error_model="numpy", forceinline=True)
def angles_near(anchors, k_r, k_z):
    """As :func:`angle_near` of all three legs, `compiled.lanes`."""
    a = anchors
    turned = _turned(three(a[0, 1], a[1, 1], a[2, 1]), three(a[0, 2], a[1, 2], a[2, 2]), k_r, k_z)
    if abs(turned[0]) < SMALL and abs(turned[1]) < SMALL and abs(turned[2]) < SMALL:
        return three(a[0, 0], a[1, 0], a[2, 0]) + _arc_sine(turned)
    angles = turned
    for leg in range(3):
        angles = with_lane(angles, leg, angle_near(a, leg, k_r[leg], k_z[leg]))
    return angles


@njit(cache=True, error_model="numpy")
def move_anchor(geometry, anchors, leg, k_r, k_z):
    """Make the anchor of a leg the pose with its knee at (k_r, k_z), if it is not near any more.

    It is not moved each time: an angle would gather the rounding of all those before it.
    """
    if not abs(_turned(anchors[leg, 1], anchors[leg, 2], k_r, k_z)) < 0.5 * SMALL:
        anchors[leg, 0] = math.atan2(-k_z, k_r)
        square = geometry.l_a * geometry.l_a
        anchors[leg, 1], anchors[leg, 2] = k_r / square, -k_z / square


@njit(cache=True, error_model="numpy", forceinline=True)
def _turned(cosine, sine, k_r, k_z):
    """Sine of the angle between a knee and its anchor."""
    return -(k_z * cosine + k_r * sine)


@njit(cache=True, error_model="numpy", forceinline=True)
def _arc_sine(turned):
    n = turned * turned
    return turned * (1.0 + n * (1.0 / 6.0 + n * (3.0 / 40.0 + n * (5.0 / 112.0 + n * 35.0 / 1152.0))))
