"""Where the robot loses a motion or a force, measured from its Jacobian without units.

With e_i = A_iP_i / l_b the Jacobian is J = diag(1/(l_a sine_i)) [e_1 e_2 e_3]^T, so
det J^-1 = l_a^3 sine_1 sine_2 sine_3 / det[e_1 e_2 e_3]. The numerator vanishes at a serial singularity: a
leg is stretched or folded, at the edge of the workspace. The denominator vanishes at a parallel singularity:
the distal links lie in one plane and the platform gives way along its normal although the joints are held.
"""

import numpy as np
from numpy.typing import NDArray

from twin.errors import InputRefused
from twin.robot.geometry import Geometry
from twin.robot.triples import place

# At the edge of the workspace both measures come from angles that are roots of D (Eq. 11). D is rounded to
# about 1e-16 (l_a l_b)^2, its root to 1e-8: ten times that is the smallest value known not to be zero.
SMALLEST_KNOWN_NONZERO = 1e-7


class SingularPose(InputRefused, ValueError):
    """Torques and forces, or joint and platform speeds, do not determine each other at this pose.

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
    """Pass only if no leg is stretched or folded.

    Args:
        geometry: lengths of Fig. 2.
        J: Jacobians in rad/m at the poses, shape (..., 3, 3); rows may be infinite.
        p_B: the poses in m, shape (..., 3), for the message.

    Raises:
        SingularPose: names the first pose and leg whose transmission sine cannot be told from 0.
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
    """Pass only if the distal links span space.

    Args:
        J: Jacobians in rad/m at the poses, shape (..., 3, 3).
        p_B: the poses in m, shape (..., 3), for the message.

    Raises:
        SingularPose: names the first pose whose distal volume cannot be told from 0.
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
