"""The right-hand side of the plant: three series elastic joints, the mechanism, the contact.

In platform coordinates, with J = d theta_l / d p (3 x 3) and tau_l the torque of the springs on the joints,

    M(p) dv/dt = J^T (tau_l - b_j J v + g_a(theta_l) - I_a (dJ/dt) v) - F_ee_B - (m_p + 3/2 m_b) g e_z,
    M = (m_p + 3/2 m_b) 1 + I_a J^T J,  I_a = m_a l_a^2/3 + m_b l_a^2/2 + I_r,  g_a = (m_a/2 + m_b/2) g l_a cos theta_l:

Lagrange's equations with each rod pair's mass split between its two ends. One compiled function; the co-simulation
component and the python-control system both integrate it.
"""

from numba import njit

from twin.plant.contact import touch
from twin.robot.gravity import arm_gravity_torque, leg_inertia, platform_mass, platform_weight
from twin.robot.inverse_kinematics import leg_angle
from twin.robot.jacobian import jacobian_rate_row_times, jacobian_row
from twin.robot.sea import dead_zone, deflection, directed_load_torque, load_torque


@njit(cache=True)
def spring_deflection(parameters, leg, theta_m, theta_l):
    """Deflection that winds the spring of `leg` (rad, motor side): Eq. 19 less the belt's slip and the backlash."""
    d = deflection(theta_m, theta_l, parameters.N) - parameters.slip[leg]
    return dead_zone(d, parameters.backlash + parameters.backlash_added[leg])


@njit(cache=True)
def spring_stiffness(parameters, leg):
    """Stiffness (N m/rad) of the spring of `leg`: k_s as built, times what is left of it."""
    return parameters.k_s * parameters.k_s_share[leg]


@njit(cache=True)
def joint_torque(parameters, leg, d, omega_l):
    """tau_l (N m) that the spring of `leg` at deflection `d` puts on the joint (Eq. 20), efficiency as configured."""
    k_s = spring_stiffness(parameters, leg)
    if parameters.eta_rate > 0.0:
        return directed_load_torque(k_s, parameters.N, parameters.eta, d, omega_l, parameters.eta_rate)
    return load_torque(k_s, parameters.N, parameters.eta, d)


# numpy's division: a robot without mass has to give infinity, because an exception of compiled code that the master
# calls by address is lost
@njit(cache=True, error_model="numpy")
def _solve_symmetric(a, b, c, d, e, f, x, y, z):
    """Solve [[a, b, c], [b, d, e], [c, e, f]] s = (x, y, z) by cofactors."""
    m11, m12, m13 = d * f - e * e, c * e - b * f, b * e - c * d
    m22, m23, m33 = a * f - c * c, b * c - a * e, a * d - b * b
    det = a * m11 + b * m12 + c * m13
    return (
        (m11 * x + m12 * y + m13 * z) / det,
        (m12 * x + m22 * y + m23 * z) / det,
        (m13 * x + m23 * y + m33 * z) / det,
    )


@njit(cache=True)
def derivative(parameters, x, theta_m, s_B, v_s_B, dx):
    """dx/dt into `dx`, for the state `x` (8,) of `parameters.py` and motor angles `theta_m` (3,), all SI.

    `s_B`, `v_s_B` (3,) are displacement (m) and velocity (m/s) of the surface; it does not turn. Outside the workspace
    the angles do not exist and `dx` becomes NaN.
    """
    px, py, pz, vx, vy, vz, z_1, z_2 = x[0], x[1], x[2], x[3], x[4], x[5], x[6], x[7]
    inertia = leg_inertia(parameters, parameters)
    m11 = m22 = m33 = platform_mass(parameters)
    m12 = m13 = m23 = 0.0
    # the platform as the surface sees it
    rx, ry, rz = px - s_B[0], py - s_B[1], pz - s_B[2]
    ux, uy, uz = vx - v_s_B[0], vy - v_s_B[1], vz - v_s_B[2]
    contact_x, contact_y, contact_z, _, dx[6], dx[7] = touch(parameters, rx, ry, rz, ux, uy, uz, z_1, z_2)
    fx, fy, fz = -contact_x, -contact_y, -contact_z - platform_weight(parameters)
    for leg in range(3):
        theta_l = leg_angle(parameters, leg, px, py, pz)
        jx, jy, jz = jacobian_row(parameters, leg, theta_l, px, py, pz)
        omega_l = jx * vx + jy * vy + jz * vz
        tau_l = joint_torque(parameters, leg, spring_deflection(parameters, leg, theta_m[leg], theta_l), omega_l)
        tau = (
            tau_l
            - (parameters.b_j + parameters.b_j_added[leg]) * omega_l
            + arm_gravity_torque(parameters, parameters, theta_l)
            - inertia * jacobian_rate_row_times(parameters, leg, theta_l, px, py, pz, vx, vy, vz)
        )
        fx, fy, fz = fx + jx * tau, fy + jy * tau, fz + jz * tau
        m11, m12, m13 = m11 + inertia * jx * jx, m12 + inertia * jx * jy, m13 + inertia * jx * jz
        m22, m23, m33 = m22 + inertia * jy * jy, m23 + inertia * jy * jz, m33 + inertia * jz * jz
    dx[0], dx[1], dx[2] = vx, vy, vz
    dx[3], dx[4], dx[5] = _solve_symmetric(m11, m12, m13, m22, m23, m33, fx, fy, fz)
