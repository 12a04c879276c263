"""Statics, Eq. 18-27: springs, the robot's own weight, and the force between the end-effector and its environment.

The series elastic actuator consists of motor, spring, belt and load (Fig. 3 A), Eq. 18-20. The spring is between motor
and belt, so d = theta_m - N theta_l is its deflection on the motor's side.

The paper's statics neglect the robot's own weight and inertia. All rods are uniform, so the weight of a distal rod pair
acts half at A_i and half at the platform; its inertia is in `plant.dynamics`. Positive theta_l lowers the arm, so its
weight is a positive torque.

Eq. 21-27 convert load torques to the force of the end-effector and back, leg by leg in the leg's own frame O_i, whose x
axis is the joint's axis and whose -y axis is the leg's outward direction. Two corrections to the print: a vector enters
O_i by the rotation that Eq. 23 prints for the other leg, and Eq. 26 rotates back the force vector F_Ai e_i, not its
magnitude.
"""

import math
from typing import NamedTuple

import numpy as np
from numpy.typing import ArrayLike, NDArray

from twin.kernel.compiled.function import carray, njit
from twin.kernel.compiled.native import entry
from twin.robot.mechanism.geometry import LEG_COS, LEG_SIN, Geometry, distal_link, triples
from twin.robot.mechanism.kinematics import (
    jacobian,
    jacobian_row,
    jacobian_rows,
    position,
    refuse_parallel_singularity,
    refuse_serial_singularity,
)

G_ACCELERATION = 9.81


@njit(cache=True)
def deflection(theta_m, theta_l, N):
    """Spring deflection theta_s = theta_m - N theta_l in rad on the motor's side, Eq. 19."""
    return theta_m - N * theta_l


@njit(cache=True, forceinline=True)
def dead_zone(d, half_width):
    """Deflection in rad left after backlash: 0 for |d| <= half_width, beyond that d reduced by half_width."""
    if d > half_width:
        return d - half_width
    if d < -half_width:
        return d + half_width
    # not 0.0: a deflection that is not a number has to stay one
    return 0.0 * d


@njit(cache=True)
def motor_load_torque(k_s, d):
    """Torque in N m the spring asks of the motor shaft, tau_r = k_s d = tau_l / (N eta), Eq. 18."""
    return k_s * d


@njit(cache=True)
def load_torque(k_s, N, eta, d):
    """Torque in N m on the proximal link, tau_l = k_s N eta d, Eq. 20: the paper's constant efficiency."""
    return k_s * N * eta * d


@njit(cache=True)
def directed_load_torque(k_s, N, eta, d, thetadot_l, rate):
    """Torque in N m on the proximal link with losses in the direction of the power flow.

    A belt that loses power passes tau_l = N eta tau_r while the spring drives the load
    (tau_r thetadot_l > 0) and tau_l = N tau_r / eta while the load drives the spring; the constant eta of
    Eq. 18 and 20 would give power back in the second case. The factor is eta**s with
    s = sign(tau_r) tanh(thetadot_l / rate): it blends through 1 at rest and never creates power, because s
    has the sign of tau_r thetadot_l.

    Args:
        k_s: spring stiffness in N m/rad.
        N: belt ratio.
        eta: efficiency, 0 < eta <= 1.
        d: spring deflection after backlash in rad.
        thetadot_l: speed of the proximal link in rad/s.
        rate: speed in rad/s over which the direction blends; 0.76 of the loss is reached at this speed.
    """
    tau_r = motor_load_torque(k_s, d)
    s = math.copysign(1.0, tau_r) * math.tanh(thetadot_l / rate)
    return N * tau_r * eta**s


def platform_stiffness(J: NDArray[np.float64], joint_stiffness: float) -> NDArray[np.float64]:
    """Stiffness (N/m) that the springs give the platform along x, y and z, motors and the other axes held, (3,).

    The diagonal of J^T k J, as F = J^T tau_l (Eq. 21-27), tau_l = k dtheta_l with k = k_s N^2 eta (Eq. 18-20), and
    dtheta_l = J dp_B.

    Args:
        J: Jacobian d theta_l / d p_B in rad/m, (3, 3).
        joint_stiffness: k in N m/rad.
    """
    return np.array([joint_stiffness * (column @ column) for column in J.T])


class Masses(NamedTuple):
    """Masses (kg) and inertia (kg m^2) of the moving parts, m_a and m_b as in Fig. 2.

    The compiled functions read these attributes only, so they also accept any other record that has them.

    Attributes:
        m_a: one proximal rod.
        m_b: the two rods of one distal link together.
        m_p: platform.
        I_r: inertia of pulley and encoder about the joint axis, without the rod.
    """

    m_a: float
    m_b: float
    m_p: float
    I_r: float


@njit(cache=True)
def arm_gravity_torque(geometry, masses, theta):
    """Torque in N m of one arm's weight on its joint: (m_a/2 + m_b/2) g l_a cos(theta)."""
    return arm_weight(masses) * geometry.l_a * math.cos(theta)


@njit(cache=True)
def arm_weight(masses):
    """Weight in N that hangs at one knee A_i: (m_a/2 + m_b/2) g."""
    return 0.5 * (masses.m_a + masses.m_b) * G_ACCELERATION


@njit(cache=True)
def platform_weight(masses):
    """Weight in N that hangs at the platform: (m_p + 3/2 m_b) g."""
    return (masses.m_p + 1.5 * masses.m_b) * G_ACCELERATION


@njit(cache=True)
def moving_mass(masses):
    """Mass in kg that the platform's own acceleration feels: m_p + m_b, of three uniform rod pairs."""
    return masses.m_p + masses.m_b


@njit(cache=True)
def leg_inertia(geometry, masses):
    """Inertia in kg m^2 that a joint's own acceleration feels: (m_a + m_b) l_a^2/3 + I_r, of uniform rods."""
    return (masses.m_a + masses.m_b) / 3.0 * geometry.l_a * geometry.l_a + masses.I_r


@njit(cache=True)
def environment_force(geometry, masses, theta_l, p_B, tau_l):
    """Force F_ee_B in N by the robot at rest on its environment, its own weight included: ``(x, y, z)``.

    F_ee_B = J^T (tau_l + arm gravity torque) - platform weight e_z: Eq. 27 corrected for gravity.

    Args:
        geometry, masses: records with the attributes of Geometry and Masses.
        theta_l, p_B, tau_l: joint angles in rad, the platform position in m that belongs to them and load
            torques in N m, anything that can be indexed 0..2.
    """
    F_x, F_y, F_z = 0.0, 0.0, -platform_weight(masses)
    for leg in range(3):
        j_x, j_y, j_z = jacobian_row(geometry, leg, theta_l[leg], p_B[0], p_B[1], p_B[2])
        tau = tau_l[leg] + arm_gravity_torque(geometry, masses, theta_l[leg])
        F_x += j_x * tau
        F_y += j_y * tau
        F_z += j_z * tau
    return F_x, F_y, F_z


@entry("nothing", "doubles", "doubles", "doubles", "doubles", "doubles", "doubles")
def _press(lengths, weights, theta_l, p_B, tau_l, F_ee_B):
    geometry = Geometry(lengths[0], lengths[1], lengths[2], lengths[3])
    masses = Masses(weights[0], weights[1], weights[2], weights[3])
    F_ee_B[0], F_ee_B[1], F_ee_B[2] = environment_force(geometry, masses, theta_l, p_B, tau_l)


def force_on_environment(
    geometry: Geometry, masses: Masses, theta_l: ArrayLike, p_B: ArrayLike, tau_l: ArrayLike
) -> NDArray:
    """Return the force F_ee_B (3,) in N of the robot on its environment at rest, bit-identical to compiled code."""
    force = np.empty(3)
    arrays = (np.array(values, dtype=np.float64) for values in (geometry, masses, theta_l, p_B, tau_l))
    _press(*arrays, force)
    return force


@njit(cache=True, error_model="numpy")
def leg_force(geometry, leg, theta, x, y, z, tau):
    """Force in N that leg i passes to the platform along its distal link, Eq. 21-26: ``(x, y, z)`` in B.

    Eq. 25 about the joint's axis reads l_a (sin(theta) e_y - cos(theta) e_z) F_A = tau in O_i.

    Args:
        geometry: a :class:`~twin.robot.mechanism.geometry.Geometry` or a record with its attributes.
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
        geometry: a :class:`~twin.robot.mechanism.geometry.Geometry` or a record with its attributes.
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
    """Load torques tau_l = J^-T F_ee_B in N m of a weightless robot that exerts F_ee_B at rest.

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
