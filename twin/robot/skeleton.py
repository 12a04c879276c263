"""Where the joints of the closed chain are, for whoever draws the robot: Fig. 2, Eq. 3-6."""

from typing import NamedTuple

import numpy as np
from numpy.typing import ArrayLike, NDArray

from twin.robot.geometry import LEG_COS, LEG_SIN, Geometry
from twin.robot.triples import triples

OUTWARD = np.array([LEG_COS, LEG_SIN, (0.0, 0.0, 0.0)]).T
"""Horizontal unit vector of each leg, (3 legs, 3); its proximal link moves in the plane of it and z."""
AXIS = np.array([[-s for s in LEG_SIN], LEG_COS, (0.0, 0.0, 0.0)]).T
"""Unit vector of each base joint's axis, (3 legs, 3): a right-handed turn by theta_l lowers the link's end.

The short sides of the parallelogram, at A_i and at P_i, stay parallel to it.
"""


class Skeleton(NamedTuple):
    """Joints of the three legs in the base frame, m; n poses.

    Attributes:
        B: base joints B_i, (3, 3).
        A: ends of the proximal links A_i, (n, 3, 3).
        P: platform joints P_i, (n, 3, 3).
    """

    B: NDArray[np.float64]
    A: NDArray[np.float64]
    P: NDArray[np.float64]


def skeleton(geometry: Geometry, theta_l: ArrayLike, p_B: ArrayLike) -> Skeleton:
    """Joints of the legs for joint angles and the platform position that goes with them.

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
