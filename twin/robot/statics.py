"""Static force analysis, Eq. 21-27: load torques to the force of the end-effector and back.

The paper's route, leg by leg in the leg's own frame O_i, whose x axis is the joint's axis and whose -y axis
is the leg's outward direction. Two corrections to the print: a vector enters O_i by the rotation that Eq. 23
prints for the other leg, and what Eq. 26 rotates back is the force vector F_Ai e_i, not its magnitude.
"""

import math

import numpy as np
from numpy.typing import ArrayLike, NDArray

from twin.compiled.function import carray, njit
from twin.compiled.native import entry
from twin.robot.forward_kinematics import position
from twin.robot.geometry import LEG_COS, LEG_SIN, Geometry, distal_link
from twin.robot.jacobian import jacobian, jacobian_rows
from twin.robot.singularity import refuse_parallel_singularity, refuse_serial_singularity
from twin.robot.triples import triples


@njit(cache=True, error_model="numpy")
def leg_force(geometry, leg, theta, x, y, z, tau):
    """Force in N that leg i passes to the platform along its distal link, Eq. 21-26: ``(x, y, z)`` in B.

    Eq. 25 about the joint's axis reads l_a (sin(theta) e_y - cos(theta) e_z) F_A = tau in O_i.

    Args:
        geometry: a :class:`~twin.robot.geometry.Geometry` or a record with its attributes.
        leg: 0, 1 or 2.
        theta: joint angle of this leg in rad, consistent with the position.
        x, y, z: platform position in the base frame in m.
        tau: load torque tau_l of this leg in N m, positive pushing the platform down.
    """
    cos_theta, sin_theta = math.cos(theta), math.sin(theta)
    s_x, s_y, s_z = distal_link(geometry, leg, cos_theta, sin_theta, x, y, z)
    length = math.sqrt(s_x * s_x + s_y * s_y + s_z * s_z)
    # O_i is B turned by phi_i + 90 degrees about z: its y axis is (-cos(phi_i), -sin(phi_i)) in B
    e_y = -(s_x * LEG_COS[leg] + s_y * LEG_SIN[leg]) / length
    e_x = (-s_x * LEG_SIN[leg] + s_y * LEG_COS[leg]) / length
    e_z = s_z / length
    F_A = tau / (geometry.l_a * (sin_theta * e_y - cos_theta * e_z))
    return (
        F_A * (-LEG_SIN[leg] * e_x - LEG_COS[leg] * e_y),
        F_A * (LEG_COS[leg] * e_x - LEG_SIN[leg] * e_y),
        F_A * e_z,
    )


@njit(cache=True)
def resultant_force(geometry, theta_l, p_B, tau_l):
    """Sum of the three leg forces, F_ee_B in N, Eq. 27: ``(x, y, z)``.

    Args:
        geometry: a :class:`~twin.robot.geometry.Geometry` or a record with its attributes.
        theta_l, p_B, tau_l: joint angles in rad, the platform position in m that belongs to them and load
            torques in N m, anything that can be indexed 0..2.
    """
    F_x, F_y, F_z = 0.0, 0.0, 0.0
    for leg in range(3):
        f_x, f_y, f_z = leg_force(geometry, leg, theta_l[leg], p_B[0], p_B[1], p_B[2], tau_l[leg])
        F_x += f_x
        F_y += f_y
        F_z += f_z
    return F_x, F_y, F_z


@entry("nothing", "doubles", "doubles", "doubles", "doubles", "int", "doubles")
def _forces(lengths, angles, positions, torques, poses, forces):
    geometry = Geometry(lengths[0], lengths[1], lengths[2], lengths[3])
    theta_l, p_B, tau_l = carray(angles, (poses, 3)), carray(positions, (poses, 3)), carray(torques, (poses, 3))
    F_ee_B = carray(forces, (poses, 3))
    for row in range(poses):
        F_ee_B[row, 0], F_ee_B[row, 1], F_ee_B[row, 2] = resultant_force(geometry, theta_l[row], p_B[row], tau_l[row])


def end_effector_force(geometry: Geometry, theta_l: ArrayLike, tau_l: ArrayLike) -> NDArray[np.float64]:
    """Force F_ee_B in N by the weightless robot at rest on its environment, Eq. 21-27 corrected.

    Equal to J^T tau_l, the principle of virtual work, at every pose. The knees are outward.

    Args:
        geometry: lengths of Fig. 2.
        theta_l: joint angles in rad, shape (..., 3).
        tau_l: load torques in N m, shape broadcastable with theta_l, positive pushing the platform down.

    Returns:
        Forces in the base frame, shape (..., 3).

    Raises:
        SingularPose: a leg is stretched or folded (the denominator of Eq. 25 is 0).
        Unreachable: the distal links do not meet at these joint angles.
        InputRefused: an argument is not finite or not of shape (..., 3).
    """
    theta_l, tau_l = np.broadcast_arrays(triples(theta_l, "theta_l"), triples(tau_l, "tau_l"))
    p_B = position(geometry, theta_l)
    theta_n, p_n, tau_n = (np.ascontiguousarray(array).reshape(-1, 3) for array in (theta_l, p_B, tau_l))
    refuse_serial_singularity(geometry, jacobian_rows(geometry, theta_n, p_n), p_B)
    F_ee_B = np.empty_like(p_n)
    _forces(np.array(geometry, dtype=float), theta_n, p_n, tau_n, len(p_n), F_ee_B)
    return F_ee_B.reshape(p_B.shape)


def joint_torques(geometry: Geometry, p_B: ArrayLike, F_ee_B: ArrayLike) -> NDArray[np.float64]:
    """Load torques tau_l = J^-T F_ee_B in N m with which the weightless robot exerts F_ee_B at rest.

    The inverse of :func:`end_effector_force`.

    Args:
        geometry: lengths of Fig. 2.
        p_B: platform positions in the base frame in m, shape (..., 3).
        F_ee_B: forces by the robot on the environment in N, shape broadcastable with p_B.

    Returns:
        Load torques of the three legs, shape (..., 3).

    Raises:
        SingularPose: a leg is stretched or folded, or the three distal links lie in one plane and no torque
            holds a force along its normal.
        Unreachable: a pose has no joint angles.
        InputRefused: an argument is not finite or not of shape (..., 3).
    """
    p_B, F_ee_B = np.broadcast_arrays(triples(p_B, "p_B"), triples(F_ee_B, "F_ee_B"))
    J = jacobian(geometry, p_B)
    refuse_parallel_singularity(J, p_B)
    return np.linalg.solve(np.swapaxes(J, -1, -2), F_ee_B[..., None])[..., 0]
