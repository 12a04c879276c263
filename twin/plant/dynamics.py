"""The acceleration of the plant: three series elastic joints, the mechanism, the contact.

In platform coordinates, with J = d theta_l / d p (3 x 3), tau_l the torque of the springs on the joints, omega = J v,
kappa = (dJ/dt) v, d_i = dA_i/d theta_i and d'_i = d^2 A_i/d theta_i^2 of knee i,

    M(p) dv/dt = J^T (tau_l - b_j omega + g_a) - c - F_ee_B - (m_p + 3/2 m_b) g e_z,
    M = (m_p + m_b) 1 + I_a J^T J + m_b/6 sum_i (d_i J_i + J_i^T d_i^T),
    c = I_a J^T kappa + m_b/6 sum_i (d_i kappa_i + d'_i omega_i^2),
    I_a = (m_a + m_b) l_a^2/3 + I_r,  g_a = (m_a/2 + m_b/2) g l_a cos theta_l:

Lagrange's equations of uniform rods (P2 to P6 of docs/physics.md). Where the base is tilted, e_z is `mounting.upward`;
dry friction and hard stops add to the joints' torques (`friction.py`). One compiled function; the co-simulation
component and the python-control system both integrate it.
"""

import math

import numpy as np

from twin.compiled.function import njit
from twin.compiled.lanes import with_lane
from twin.plant.contact import ANCHORS, drag, friction_torque, gripped, stop_torque, stopped, touch
from twin.plant.surface import apex_frame, hanging, upward
from twin.robot.geometry import coordinates_along, legs
from twin.robot.gravity import arm_weight, leg_inertia, moving_mass, platform_weight
from twin.robot.leg import angle_near, angles_near, leg_motion, leg_vectors, links
from twin.robot.sea import dead_zone, deflection, directed_load_torque, load_torque

UNTOUCHED = np.full((3, ANCHORS), np.nan)
"""Anchors of a robot that was nowhere yet: no angle is known, and no friction holds."""


@njit(cache=True, forceinline=True)
def spring_deflection(parameters, leg, theta_m, theta_l):
    """Deflection that winds the spring of `leg` (rad, motor side): Eq. 19 less the belt's slip and the backlash."""
    d = deflection(theta_m, theta_l, parameters.N) - parameters.slip[leg]
    return dead_zone(d, parameters.backlash + parameters.backlash_added[leg])


@njit(cache=True, forceinline=True)
def spring_stiffness(parameters, leg):
    """Stiffness (N m/rad) of the spring of `leg`: k_s as built, times what is left of it."""
    return parameters.k_s * parameters.k_s_share[leg]


@njit(cache=True, error_model="numpy", forceinline=True)
def series_share(parameters, leg):
    """What a belt in series leaves of the stiffness of the spring of `leg` (1).

    A belt without mass that yields by c per torque on the joint leaves 1/k = 1/k_s + N^2 c on the motor's side.
    """
    return 1.0 / (1.0 + spring_stiffness(parameters, leg) * parameters.N * parameters.N * parameters.belt_compliance)


@njit(cache=True, forceinline=True)
def has_effects(parameters):
    """Whether the robot has any of the small effects that turn its joints; if not, nothing need be looked at again."""
    p = parameters
    springs = (p.belt_compliance > 0.0) | (p.spring_hysteresis > 0.0) | (p.spring_stop < math.inf)
    joints = (p.joint_friction > 0.0) | (p.joint_lower > -math.inf) | (p.joint_upper < math.inf)
    return springs | joints | (p.mounting_tilt != 0.0) | (p.mounting_tilt_x != 0.0)


@njit(cache=True)
def winding(parameters, anchors, leg, theta_m, theta_l):
    """Deflection (rad, motor side) of an ideal spring that carries what the spring of `leg` does, which may be at its
    stop, have hysteresis and be in series with a belt that yields."""
    d = stopped(parameters, spring_deflection(parameters, leg, theta_m, theta_l))
    if parameters.spring_hysteresis > 0.0:
        d = gripped(parameters, anchors, leg, d)
    return series_share(parameters, leg) * d


@njit(cache=True)
def _push(parameters, anchors, leg, theta_l):
    """Torque (N m) of dry friction and hard stops on the joint of `leg`."""
    push = stop_torque(parameters, theta_l)
    return push - friction_torque(parameters, anchors, leg, theta_l) if parameters.joint_friction > 0.0 else push


@njit(cache=True, forceinline=True)
def head_sees(parameters, s_B):
    """Where a surface that is displaced by the triple `s_B` (m) is for a platform that would touch in O_P."""
    head = parameters.head
    return s_B[0] - head[0], s_B[1] - head[1], s_B[2] - head[2]


@njit(cache=True)
def settle_friction(parameters, x, theta_m, anchors):
    """Drag the anchors of dry friction, in place, to the state `x` at the motor angles `theta_m` (3) in rad."""
    for leg in range(3):
        k_r, k_z, _, _, _, _ = leg_vectors(parameters, leg, x[0], x[1], x[2])
        theta_l = angle_near(anchors, leg, k_r, k_z)
        d = stopped(parameters, spring_deflection(parameters, leg, theta_m[leg], theta_l))
        drag(parameters, anchors, leg, theta_l, d)


@njit(cache=True, forceinline=True)
def joint_torque(parameters, leg, d, omega_l):
    """tau_l (N m) that the spring of `leg` at deflection `d` puts on the joint (Eq. 20), efficiency as configured."""
    k_s = spring_stiffness(parameters, leg)
    if parameters.eta_rate > 0.0:
        return directed_load_torque(k_s, parameters.N, parameters.eta, d, omega_l, parameters.eta_rate)
    return load_torque(k_s, parameters.N, parameters.eta, d)


@njit(cache=True, forceinline=True)
def _joint(parameters, anchors, leg, theta_m, theta_l, omega_l, k_r, k_z, up, special):
    """Torque (N m) on the joint of `leg` by its spring, damping, dry friction and stops, and the weight of its arm.

    theta_l, omega_l, k_r, k_z are those of all legs, `compiled.lanes`; the rest as in `acceleration`.
    """
    angle, speed, hangs = theta_l[leg], omega_l[leg], arm_weight(parameters)
    if special:
        d = winding(parameters, anchors, leg, theta_m[leg], angle)
        push = hangs * hanging(up, leg, k_r[leg], k_z[leg]) + _push(parameters, anchors, leg, angle)
    else:
        d, push = spring_deflection(parameters, leg, theta_m[leg], angle), hangs * k_r[leg]
    tau_l = joint_torque(parameters, leg, d, speed)
    return tau_l - (parameters.b_j + parameters.b_j_added[leg]) * speed + push


@njit(cache=True, forceinline=True)
def _summed(start, lanes):
    return start + lanes[0] + lanes[1] + lanes[2]


# numpy's division: a robot without mass has to give infinity, because an exception of compiled code that the master
# calls by address is lost
@njit(cache=True, error_model="numpy", forceinline=True)
def _solve_symmetric(a, b, c, d, e, f, x, y, z):
    """Solve [[a, b, c], [b, d, e], [c, e, f]] s = (x, y, z) by cofactors."""
    m11, m12, m13 = d * f - e * e, c * e - b * f, b * e - c * d
    m22, m23, m33 = a * f - c * c, b * c - a * e, a * d - b * b
    share = 1.0 / (a * m11 + b * m12 + c * m13)
    return (
        (m11 * x + m12 * y + m13 * z) * share,
        (m12 * x + m22 * y + m23 * z) * share,
        (m13 * x + m23 * y + m33 * z) * share,
    )


@njit(cache=True, error_model="numpy")
def acceleration(parameters, p, v, z_b, theta_m, s_B, v_s_B, apex, anchors, special=True):
    """What the platform and the bristles do next: dv/dt (m/s^2) and dz_b/dt (m/s), two tuples.

    Outside the workspace, where there are no joint angles, both are NaN.

    Args:
        parameters: `PlantParameters`, or a record of them.
        p, v: position (m) and velocity (m/s) of the platform, triples.
        z_b: bristle deflection (m), a pair.
        theta_m: motor angles (rad), a triple.
        s_B, v_s_B: displacement (m) and velocity (m/s) of the surface as the head sees it (`head_sees`), triples; it
            does not turn.
        apex: see `touch`.
        anchors: of the joints' angles, see `robot.leg`, and of dry friction, see `friction.py`.
        special: False where `has_effects` is, which is asked once and not in each evaluation.
    """
    x, y, z = p
    vx, vy, vz = v
    inertia, sixth = leg_inertia(parameters, parameters), parameters.m_b / 6.0
    # the platform as the surface sees it
    rx, ry, rz = x - s_B[0], y - s_B[1], z - s_B[2]
    ux, uy, uz = vx - v_s_B[0], vy - v_s_B[1], vz - v_s_B[2]
    contact_x, contact_y, contact_z, _, dz_1, dz_2 = touch(parameters, apex, rx, ry, rz, ux, uy, uz, z_b[0], z_b[1])
    up, weight = (0.0, 0.0, 1.0), platform_weight(parameters)
    fx, fy, fz = -contact_x, -contact_y, -contact_z - weight
    if special:
        up = upward(parameters)
        fx, fy, fz = fx - weight * up[0], fy - weight * up[1], -contact_z - weight * up[2]
    # all three legs at once, in their own frames: outward, sideways, up
    C, S = legs()
    u, w = coordinates_along(parameters, C, S, x, y)
    k_r, k_z, r, w, h, q = links(parameters, u, w, z)
    j_r, j_w, j_z, omega_l, kappa = leg_motion(parameters, k_r, k_z, r, w, h, q, C * vx + S * vy, C * vy - S * vx, vz)
    square = omega_l * omega_l
    theta_l = angles_near(anchors, k_r, k_z)
    tau = omega_l
    for leg in range(3):
        own = _joint(parameters, anchors, leg, theta_m, theta_l, omega_l, k_r, k_z, up, special)
        tau = with_lane(tau, leg, own)
    tau = tau - inertia * kappa
    f_r = j_r * tau - sixth * (k_z * kappa - k_r * square)
    f_w = j_w * tau
    fx, fy = _summed(fx, C * f_r - S * f_w), _summed(fy, S * f_r + C * f_w)
    fz = _summed(fz, j_z * tau + sixth * (k_r * kappa + k_z * square))
    # I_a/2 J_i + m_b/6 d_i, of which M has the product with J_i and its transpose
    a_r, a_w, a_z = 0.5 * inertia * j_r + sixth * k_z, 0.5 * inertia * j_w, 0.5 * inertia * j_z - sixth * k_r
    jx, jy = C * j_r - S * j_w, S * j_r + C * j_w
    ax, ay = C * a_r - S * a_w, S * a_r + C * a_w
    m, zero = moving_mass(parameters), 0.0
    m11, m12, m13 = _summed(m, 2.0 * ax * jx), _summed(zero, ax * jy + ay * jx), _summed(zero, ax * j_z + a_z * jx)
    m22, m23, m33 = _summed(m, 2.0 * ay * jy), _summed(zero, ay * j_z + a_z * jy), _summed(m, 2.0 * a_z * j_z)
    return _solve_symmetric(m11, m12, m13, m22, m23, m33, fx, fy, fz), (dz_1, dz_2)


@njit(cache=True)
def derivative(parameters, x, theta_m, s_B, v_s_B, dx):
    """dx/dt into `dx`, for the state `x` (8,) of `parameters.py`, without dry friction; else as `acceleration`."""
    derivative_near(parameters, x, theta_m, s_B, v_s_B, UNTOUCHED, dx)


@njit(cache=True)
def derivative_near(parameters, x, theta_m, s_B, v_s_B, anchors, dx):
    """As `derivative`, with dry friction that holds where `anchors` say."""
    p, v, z_b, s_B = (x[0], x[1], x[2]), (x[3], x[4], x[5]), (x[6], x[7]), head_sees(parameters, s_B)
    dx[0], dx[1], dx[2] = v
    dv, dz = acceleration(parameters, p, v, z_b, theta_m, s_B, v_s_B, apex_frame(parameters), anchors)
    dx[3], dx[4], dx[5] = dv
    dx[6], dx[7] = dz
