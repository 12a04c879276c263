"""Where the robot can work: reach per leg, height range over a point, conditioning."""

import numpy as np
from numpy.typing import ArrayLike, NDArray

from twin.compiled.function import carray, njit
from twin.compiled.native import entry
from twin.errors import Unreachable
from twin.robot.forward_kinematics import circumcentre
from twin.robot.geometry import LEG_COS, LEG_SIN, Geometry
from twin.robot.inverse_kinematics import distal_length_range, leg_angle
from twin.robot.jacobian import jacobian
from twin.robot.triples import triples


def reach_margins(geometry: Geometry, p_B: ArrayLike) -> NDArray[np.float64]:
    """How much each distal link could change in length before its leg cannot follow, in m, shape (..., 3).

    The smaller of longest - l_b and l_b - shortest, see
    :func:`twin.robot.inverse_kinematics.distal_length_range`; zero where D of Eq. 11 is zero, negative out of
    reach by the missing length.

    Args:
        geometry: lengths of Fig. 2.
        p_B: platform positions in the base frame in m, shape (..., 3).

    Raises:
        InputRefused: p_B is not finite or not of shape (..., 3).
    """
    p_B = triples(p_B, "p_B")
    shortest, longest = np.stack([distal_length_range(geometry, leg, p_B) for leg in range(3)], axis=-1)
    return np.minimum(longest - geometry.l_b, geometry.l_b - shortest)


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

    Beyond it the joint angles exist too, but the robot stands elsewhere at those angles: it cannot cross.

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


def height_range(geometry: Geometry, x: float, y: float) -> tuple[float, float]:
    """Lowest and highest reachable platform height z <= 0 in m over the point (x, y).

    Leg i reaches where |sqrt(l_b^2 - w^2) - l_a| <= sqrt(u^2 + z^2) <= sqrt(l_b^2 - w^2) + l_a, which is
    Eq. 7 with A_i anywhere on its circle; the range is what the three legs share.

    Args:
        geometry: lengths of Fig. 2.
        x, y: position in the base frame in m.

    Raises:
        Unreachable: no height is reachable by all legs. Names the leg that reaches least far down; the excess
            is the length its distal link is short of, or the gap between its heights and those of the others.
    """
    outward = x * np.array(LEG_COS) + y * np.array(LEG_SIN)
    u = outward - (geometry.a - geometry.b)
    w = -x * np.array(LEG_SIN) + y * np.array(LEG_COS)
    in_plane = np.sqrt(np.maximum(geometry.l_b**2 - w**2, 0.0))
    missing = np.hypot(np.maximum(np.abs(u) - geometry.l_a, 0.0), w) - geometry.l_b
    lowest = -np.sqrt(np.maximum((in_plane + geometry.l_a) ** 2 - u**2, 0.0))
    highest = -np.sqrt(np.maximum((in_plane - geometry.l_a) ** 2 - u**2, 0.0))
    gap = lowest.max() - highest.min()
    if missing.max() > 0.0 or gap > 0.0:
        leg = int(np.argmax(missing if missing.max() > 0.0 else lowest)) + 1
        raise Unreachable(
            f"no height over (x, y) = ({1e3 * x:.1f}, {1e3 * y:.1f}) mm is within reach of leg {leg} and the "
            "others; move the point towards the axis",
            leg=leg,
            pose=(x, y),
            excess=float(max(missing.max(), gap)),
        )
    return float(lowest.max()), float(highest.min())


def condition_number(geometry: Geometry, p_B: ArrayLike) -> NDArray[np.float64]:
    """Condition number of J = d theta_l / d p_B in the 2-norm, shape (...): 1 is equally strong all ways.

    Args:
        geometry: lengths of Fig. 2.
        p_B: platform positions in the base frame in m, shape (..., 3).

    Raises:
        Unreachable: a pose has no joint angles.
        SingularPose: a leg is stretched or folded.
        InputRefused: p_B is not finite or not of shape (..., 3).
    """
    return np.linalg.cond(jacobian(geometry, p_B))
