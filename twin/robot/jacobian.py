"""The Jacobian J = d theta_l / d p_B.

The time derivative of Eq. 7, s_i . (v - d_i dtheta_i/dt) = 0 with s_i = A_iP_i, d_i = dA_i/dtheta_i and
v = dp_B/dt, gives row i of J as s_i^T / (s_i . d_i). The denominator is +sqrt(D)/2 with the knee outward
(D of Eq. 11), -sqrt(D)/2 with the knee inward; where it vanishes the leg is stretched or folded: the serial
singularity, which is the edge of the workspace.
"""

import numpy as np
from numpy.typing import ArrayLike, NDArray

from twin.compiled.function import carray, njit
from twin.compiled.native import entry
from twin.robot.geometry import LEG_COS, LEG_SIN, Geometry, distal_link
from twin.robot.inverse_kinematics import joint_angles
from twin.robot.singularity import refuse_serial_singularity
from twin.robot.triples import triples


# numpy's division: at a serial singularity the row is infinite, it does not raise inside the compiled loop
@njit(cache=True, error_model="numpy")
def jacobian_row(geometry, leg, theta, x, y, z):
    """Row i of J = d theta_l / d p_B in rad/m: ``(j_x, j_y, j_z)``.

    Args:
        geometry: a :class:`~twin.robot.geometry.Geometry` or a record with its attributes.
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
