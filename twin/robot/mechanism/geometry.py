"""The robot's geometry (Fig. 2) and the vectors of one leg, Eq. 3-6.

Leg i (1..3 in the paper, ``leg`` = 0..2 here) stands at phi_i = -90, 30, 150 degrees about z of the base
frame B. Its proximal link turns in the vertical plane through phi_i. theta_i is zero with the link horizontal
and outward; positive theta_i lowers A_i, as printed in Eq. 5.

A leg without trigonometry: Eq. 7 solved for the knee as a point instead of for the angle.

In the leg's own frame (outward, sideways, up from B_i) the platform joint P_i is at (u, w, z) and the knee A_i at
(k_r, 0, k_z) = l_a (cos theta, 0, -sin theta). |A_iP_i| = l_b (Eq. 7) and |B_iA_i| = l_a give

    k_r u + k_z z = l_a g,   g = (u^2 + w^2 + z^2 + l_a^2 - l_b^2) / (2 l_a),

a line across the knee's circle; of the two points where they meet the outward one is

    (k_r, k_z) = l_a / (u^2 + z^2) (g (u, z) + q (-z, u)),   q = sqrt(u^2 + z^2 - g^2) = sqrt(D) / (2 l_a)

with D of Eq. 11. d = dA_i/d theta is (k_z, 0, -k_r), and the Jacobian's denominator is s . d = l_a q.
"""

import math
from typing import NamedTuple

import numpy as np
from numpy.typing import ArrayLike, NDArray

from twin.kernel.compiled.function import njit, three, with_lane
from twin.kernel.errors import InputRefused
from twin.kernel.settings import Settings, Triple, Values, setting

# exact, because sin and cos of phi_i in floating point are off by up to 1e-16 and would tilt the symmetry
LEG_COS = (0.0, math.sqrt(3.0) / 2.0, -math.sqrt(3.0) / 2.0)
LEG_SIN = (-1.0, 0.5, 0.5)
OUTWARD = np.array([LEG_COS, LEG_SIN, (0.0, 0.0, 0.0)]).T
"""Horizontal unit vector of each leg, (3 legs, 3); its proximal link moves in the plane of it and z."""
AXIS = np.array([[-s for s in LEG_SIN], LEG_COS, (0.0, 0.0, 0.0)]).T
"""Unit vector of each base joint's axis, (3 legs, 3): a right-handed turn by theta_l lowers the link's end.

The short sides of the parallelogram, at A_i and at P_i, stay parallel to it.
"""
MAX_SERIES_SINE = 1.0 / 64.0
"""Maximum sine of the rotation from an anchor for which the arc sine is a series: its first missing term is 2e-20."""
NO_ANCHOR = np.full((3, 3), np.nan)
"""Anchors that no pose is near."""


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
    """Horizontal coordinates ``(u, w)`` in m of P_i in leg i's own plane, for the platform at (x, y).

    u_i = p_x cos(phi_i) + p_y sin(phi_i) - (a - b) is the distance from B_i to P_i along the leg's outward
    direction, w_i = -p_x sin(phi_i) + p_y cos(phi_i) the distance out of the plane in which the
    proximal link moves.
    """
    return coordinates_along(geometry, LEG_COS[leg], LEG_SIN[leg], x, y)


@njit(cache=True, forceinline=True)
def legs():
    """Return cosines and sines of the azimuths phi_i of the three legs, as `compiled.lanes`."""
    return three(LEG_COS[0], LEG_COS[1], LEG_COS[2]), three(LEG_SIN[0], LEG_SIN[1], LEG_SIN[2])


@njit(cache=True, forceinline=True)
def coordinates_along(geometry, C, S, x, y):
    """Horizontal coordinates (u, w) in m of P_i for the leg with cos(phi_i) = `C` and sin(phi_i) = `S`."""
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


class Model(Settings):
    """Robot properties known to both maker and controller: Fig. 2, Eq. 18-20, the encoders."""

    a: float = setting("mm", gt=0, help="distance from base centre to base joint (Fig. 2)")
    b: float = setting("mm", gt=0, help="distance from platform centre to platform joint (Fig. 2)")
    l_a: float = setting("mm", gt=0, help="length of the proximal link (Fig. 2)")
    l_b: float = setting("mm", gt=0, help="length of the distal link (Fig. 2)")
    m_a: float = setting("g", ge=0, help="mass of a proximal link, a uniform rod")
    m_b: float = setting("g", ge=0, help="mass of the two distal rods of a leg, of constant thickness")
    m_p: float = setting("g", ge=0, help="mass of the platform with its head")
    k_s: float = setting("N m/rad", gt=0, help="stiffness of a joint's spring, on the motor's side, Eq. 18")
    N: float = setting(gt=0, help="reduction of the belt, turns of the motor per turn of the link")
    eta: float = setting(gt=0, le=1, help="efficiency of the belt, Eq. 18")
    motor_counts_per_turn: int = setting(
        gt=0, into="encoders", field="motor_counts", help="resolution of the motors' encoders"
    )
    joint_counts_per_turn: int = setting(
        gt=0, into="encoders", field="joint_counts", help="resolution of the joints' encoders"
    )
    motor_zero: Triple = setting("deg", into="encoders", help="reading of each motor encoder at angle 0; three numbers")
    joint_zero: Triple = setting("deg", into="encoders", help="reading of each joint encoder at angle 0; three numbers")


def geometry_of(model: Model | Values) -> Geometry:
    """Return the lengths of Fig. 2 of `model`."""
    return Geometry(model.a, model.b, model.l_a, model.l_b)


def triples(values: ArrayLike, name: str) -> NDArray[np.float64]:
    """Convert an argument to a float array of shape (..., 3).

    Raises:
        InputRefused: the last axis is not 3 long, or a number is not finite.
    """
    array = np.asarray(values, dtype=np.float64)
    if array.ndim == 0 or array.shape[-1] != 3:
        raise InputRefused(f"{name} has shape {array.shape}; expected (..., 3)")
    if not np.isfinite(array).all():
        first = int(np.argmin(np.isfinite(array).all(axis=-1)))
        raise InputRefused(f"{name}{place(array, first)} = {array.reshape(-1, 3)[first]} is not finite")
    return array


def place(array: NDArray[np.float64], row: int) -> str:
    """Format the index of a flattened row of a (..., 3) array for an error message: ``[i, j]``; "" for a single row."""
    if array.ndim == 1:
        return ""
    return str([int(i) for i in np.unravel_index(row, array.shape[:-1])])


class Skeleton(NamedTuple):
    """Positions of all joints of the three legs in the base frame, m; n poses.

    Attributes:
        B: base joints B_i, (3, 3).
        A: ends of the proximal links A_i, (n, 3, 3).
        P: platform joints P_i, (n, 3, 3).
    """

    B: NDArray[np.float64]
    A: NDArray[np.float64]
    P: NDArray[np.float64]


def skeleton(geometry: Geometry, theta_l: ArrayLike, p_B: ArrayLike) -> Skeleton:
    """Joints of the legs for joint angles and the corresponding platform position.

    Args:
        geometry: lengths of Fig. 2.
        theta_l: angles of the proximal links in rad, (n, 3).
        p_B: platform position in m, (n, 3).

    Raises:
        InputRefused: an argument is not finite or not of shape (n, 3).
    """
    theta_l, p_B = triples(theta_l, "theta_l"), triples(p_B, "p_B")
    B = geometry.a * OUTWARD
    down = np.array([0.0, 0.0, -1.0])
    A = B + geometry.l_a * (np.cos(theta_l)[..., None] * OUTWARD + np.sin(theta_l)[..., None] * down)
    P = p_B[:, None, :] + geometry.b * OUTWARD
    return Skeleton(B, A, P)


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
    """Knee and distal link, as `leg_vectors`, of a leg with P_i at (u, w, z); three legs if u and w are lanes."""
    l_a, l_b = geometry.l_a, geometry.l_b
    square = u * u + z * z
    g = (square + w * w + (l_a * l_a - l_b * l_b)) * (0.5 / l_a)
    q = math.sqrt(square - g * g)
    share = l_a / square
    k_r, k_z = share * (g * u - q * z), share * (g * z + q * u)
    return k_r, k_z, u - k_r, w, z - k_z, q


@njit(cache=True, error_model="numpy", forceinline=True)
def leg_motion(geometry, k_r, k_z, r, w, h, q, v_r, v_w, v_z):
    """Motion of a joint with the platform, in the leg's own frame: ``(j_r, j_w, j_z, omega_l, kappa)``.

    (j_r, j_w, j_z) = s / (s . d) is the row of J = d theta_l / d p in rad/m, omega_l the joint's speed in rad/s, and
    kappa its acceleration in rad/s^2 while the platform moves at constant velocity, (dJ/dt) v. The second time
    derivative of Eq. 7 at dv/dt = 0, with d' = d^2 A_i / d theta^2 = -(k_r, 0, k_z), is

        (v - d omega) . (v - d omega) - (s . d') omega^2 - (s . d) kappa = 0.

    Args:
        geometry, k_r, k_z, r, w, h, q: see :func:`leg_vectors`; `compiled.lanes` for three legs at once.
        v_r, v_w, v_z: velocity of the platform in m/s, likewise.
    """
    share = 1.0 / geometry.l_a / q
    j_r, j_w, j_z = r * share, w * share, h * share
    omega_l = j_r * v_r + j_w * v_w + j_z * v_z
    e_r, e_z = v_r - k_z * omega_l, v_z + k_r * omega_l
    kappa = (e_r * e_r + v_w * v_w + e_z * e_z + (r * k_r + h * k_z) * (omega_l * omega_l)) * share
    return j_r, j_w, j_z, omega_l, kappa


@njit(cache=True, error_model="numpy", forceinline=True)
def angle_near(anchors, leg, k_r, k_z):
    """Return the joint angle (rad) of the leg whose knee is at (k_r, k_z); fast if its reference angle is near.

    Args:
        anchors: an angle of each leg, and its cosine and sine divided by l_a, (3, 3); see :func:`move_anchor`.
        leg: 0, 1 or 2.
        k_r, k_z: knee position in m, see :func:`leg_vectors`.
    """
    turned = _turn_sine(anchors[leg, 1], anchors[leg, 2], k_r, k_z)
    if not abs(turned) < MAX_SERIES_SINE:
        return math.atan2(-k_z, k_r)
    return anchors[leg, 0] + _arc_sine(turned)


@njit(cache=True, error_model="numpy", forceinline=True)
def angles_near(anchors, k_r, k_z):
    """Return the joint angles (rad) of all three legs from their knees, as `compiled.lanes`."""
    a = anchors
    turned = _turn_sine(three(a[0, 1], a[1, 1], a[2, 1]), three(a[0, 2], a[1, 2], a[2, 2]), k_r, k_z)
    if abs(turned[0]) < MAX_SERIES_SINE and abs(turned[1]) < MAX_SERIES_SINE and abs(turned[2]) < MAX_SERIES_SINE:
        return three(a[0, 0], a[1, 0], a[2, 0]) + _arc_sine(turned)
    angles = turned
    for leg in range(3):
        angles = with_lane(angles, leg, angle_near(a, leg, k_r[leg], k_z[leg]))
    return angles


@njit(cache=True, error_model="numpy")
def move_anchor(geometry, anchors, leg, k_r, k_z):
    """Move a leg's reference angle ("anchor") to its present angle, unless it is still near.

    It is not moved at every call, because the angle would accumulate rounding errors.
    """
    if not abs(_turn_sine(anchors[leg, 1], anchors[leg, 2], k_r, k_z)) < 0.5 * MAX_SERIES_SINE:
        anchors[leg, 0] = math.atan2(-k_z, k_r)
        square = geometry.l_a * geometry.l_a
        anchors[leg, 1], anchors[leg, 2] = k_r / square, -k_z / square


@njit(cache=True, error_model="numpy", forceinline=True)
def _turn_sine(cosine, sine, k_r, k_z):
    """Return the sine of the angle between a leg's knee and its reference angle."""
    return -(k_z * cosine + k_r * sine)


@njit(cache=True, error_model="numpy", forceinline=True)
def _arc_sine(turned):
    n = turned * turned
    return turned * (1.0 + n * (1.0 / 6.0 + n * (3.0 / 40.0 + n * (5.0 / 112.0 + n * 35.0 / 1152.0))))
