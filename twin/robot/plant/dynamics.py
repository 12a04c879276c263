"""The constants of the plant, and its acceleration: three series elastic joints, the mechanism, the contact.

In platform coordinates, with J = d theta_l / d p (3 x 3), tau_l the torque of the springs on the joints, omega = J v,
kappa = (dJ/dt) v, d_i = dA_i/d theta_i and d'_i = d^2 A_i/d theta_i^2 of knee i,

    M(p) dv/dt = J^T (tau_l - b_j omega + g_a) - c - F_ee_B - (m_p + 3/2 m_b) g e_z,
    M = (m_p + m_b) 1 + I_a J^T J + m_b/6 sum_i (d_i J_i + J_i^T d_i^T),
    c = I_a J^T kappa + m_b/6 sum_i (d_i kappa_i + d'_i omega_i^2),
    I_a = (m_a + m_b) l_a^2/3 + I_r,  g_a = (m_a/2 + m_b/2) g l_a cos theta_l:

Lagrange's equations of uniform rods (P2 to P6 of docs/physics.md). Where the base is tilted, e_z is `contact.upward`;
dry friction and hard stops add to the joints' torques (`contact.py`). One compiled function; the co-simulation
component and the python-control system both integrate it.
"""

import math

import numpy as np
from pydantic import model_validator

from twin.kernel.compiled.function import njit, with_lane
from twin.kernel.cosim.port import record_of
from twin.kernel.settings import Triple, Values, optional, setting, setting_fields
from twin.robot.mechanism.geometry import (
    Model,
    angle_near,
    angles_near,
    coordinates_along,
    leg_motion,
    leg_vectors,
    legs,
    links,
)
from twin.robot.mechanism.statics import (
    arm_weight,
    dead_zone,
    deflection,
    directed_load_torque,
    leg_inertia,
    load_torque,
    moving_mass,
    platform_weight,
)
from twin.robot.plant.contact import apex_frame, touch
from twin.robot.plant.contact_law import Contact
from twin.robot.plant.joints import (
    ANCHOR_SIZE,
    drag,
    friction_torque,
    gravity_lever,
    hysteresis_deflection,
    stop_deflection,
    stop_torque,
    upward,
)

ZERO_TRIPLE = (0.0, 0.0, 0.0)
LONGEST_GAP = 0.1
"""Maximum gap between samples of the motor angles (s) for linear interpolation: several periods of the springs' slowest
free motion, 75 rad/s."""
UNIT_SHARES = (1.0, 1.0, 1.0)
CONDITION_SETTINGS = {
    "k_s_share": setting(
        default=UNIT_SHARES,
        broken_by=("spring_softened", "spring_broken"),
        help="remaining share of k_s; 0: broken",
    ),
    "backlash_added": setting("rad", default=ZERO_TRIPLE, broken_by=("backlash_growth",), help="additional backlash"),
    "b_j_added": setting(
        "N m s/rad", default=ZERO_TRIPLE, broken_by=("joint_friction",), help="additional viscous friction"
    ),
    "slip": setting(
        "rad",
        default=ZERO_TRIPLE,
        broken_by=("belt_slip",),
        help="slip of the belt: lost deflection, motor side",
    ),
}
"""Condition of each joint; by default as built."""
STATE_SIZE = 8
"""The state x: platform position p_B (m), velocity v_B (m/s), bristle deflection z_b in the surface (m)."""
INITIAL_ANCHORS = np.full((3, ANCHOR_SIZE), np.nan)
"""Initial anchors: NaN, i.e. no reference angle, no stiction."""


class Robot(Model):
    """[robot]: a robot, including effects that its controller does not model."""

    name: str = setting(help="name of the robot, for people")
    I_r: float = setting("kg m2", ge=0, help="inertia of pulley and encoder about the joint's axis")
    b_j: float = setting("N m s/rad", ge=0, help="viscous friction of a joint")
    backlash: float = setting("deg", ge=0, help="half width of the dead zone, motor side")
    eta_rate: float = setting("rad/s", ge=0, help="speed over which eta goes from driven to driving (P1); 0: constant")
    motor_noise: float = setting(
        "deg", into="encoders", default=0.0, ge=0, help="standard deviation of a motor encoder's reading"
    )
    joint_noise: float = setting(
        "deg", into="encoders", default=0.0, ge=0, help="standard deviation of a joint encoder's reading"
    )
    motor_eccentricity: Triple = setting(
        "deg", into="encoders", default=ZERO_TRIPLE, help="amplitude of each motor encoder's error, one period per turn"
    )
    motor_eccentric_at: Triple = setting(
        "deg", into="encoders", default=ZERO_TRIPLE, help="motor angle at which that error is 0 and rising"
    )
    joint_eccentricity: Triple = setting(
        "deg", into="encoders", default=ZERO_TRIPLE, help="amplitude of each joint encoder's error, one period per turn"
    )
    joint_eccentric_at: Triple = setting(
        "deg", into="encoders", default=ZERO_TRIPLE, help="joint angle at which that error is 0 and rising"
    )
    encoder_latency: float = setting(
        "ms", into=None, default=0.0, ge=0, le=1000, help="age of a count when it is read; a whole number of ticks"
    )
    belt_compliance: float = setting(
        "rad/(N m)", default=0.0, ge=0, help="joint angle per torque of the belt, in series with the spring"
    )
    joint_friction: float = setting("N m", default=0.0, ge=0, help="dry friction of a joint (P14)")
    joint_presliding: float = setting(
        "deg", default=0.05, gt=0, help="elastic angle of a joint before its dry friction slides"
    )
    spring_hysteresis: float = setting(
        default=0.0, ge=0, le=0.5, help="dry friction of a spring as a share of its torque (P15)"
    )
    spring_stop: float | None = optional(
        "deg", absent=math.inf, gt=0, example=15.0, help="hard stop of a spring, on the motor side; without it, none"
    )
    joint_lower: float | None = optional(
        "deg", absent=-math.inf, example=-60.0, help="hard stop of a joint, upwards; without it, none"
    )
    joint_upper: float | None = optional(
        "deg", absent=math.inf, example=90.0, help="hard stop of a joint, downwards; without it, none"
    )
    stop: float = setting("N m/rad", default=100.0, gt=0, help="stiffness of hard stops")
    mounting_tilt: float = setting(
        "deg", default=0.0, ge=-180, le=180, help="tilt of the base about its y: gravity is not along -z"
    )
    mounting_tilt_x: float = setting(
        "deg", default=0.0, ge=-180, le=180, help="tilt of the base about its x, applied before the tilt about y"
    )
    head: Triple = setting("mm", default=ZERO_TRIPLE, help="contact point of the head relative to O_P (x, y, z)")
    ball_joint_limit: float | None = optional(
        "deg", into=None, gt=0, example=30.0, help="largest inclination of a rod in its ball joints; without it, any"
    )
    link_diameter: float | None = optional(
        "mm", into=None, gt=0, example=9.0, help="diameter of the proximal links, which may not collide with other legs"
    )
    rod_diameter: float | None = optional(
        "mm", into=None, gt=0, example=4.0, help="diameter of the distal rods, which may not collide with other legs"
    )
    rod_spacing: float | None = optional(
        "mm", into=None, gt=0, example=24.0, help="distance between the two rods of a pair"
    )

    @model_validator(mode="after")
    def _in_order(self) -> "Robot":
        if self.joint_lower is not None and self.joint_upper is not None and self.joint_lower >= self.joint_upper:
            raise ValueError("joint_lower_deg: expected less than joint_upper_deg")
        return self


class TrueRobot(Robot):
    """[plant]: the true robot where it differs from [robot], and its integration."""

    substeps: int = setting(into=None, ge=1, le=1000, help="Runge-Kutta steps per tick")


class PlantParameters(
    Values,
    parts=(setting_fields(TrueRobot), setting_fields(Contact), CONDITION_SETTINGS),
    # the oldest fields first; all others follow
    first="""a b l_a l_b m_a m_b m_p I_r b_j k_s N eta backlash eta_rate z_s tilt K damping mu sigma_0 sigma_1 tilt_x
    shape radius law exponent reference_depth stiffening damper touch_depth k_s_share backlash_added b_j_added slip""",
):
    """True parameters of robot and surface, SI (as opposed to the controller's belief).

    Every number of [plant] and [contact] by its name there, but for `z_s`, the height, `K`, the stiffness, `mu`, the
    friction, and `sigma_0` and `sigma_1`, the bristle's stiffness and damping (see `contact_law.py` and `contact.py`),
    and the condition of each joint. Optional values default to a robot without the effect: `eta_rate` 0, the paper's
    constant efficiency, and hard stops at infinity.
    """


PARAMETERS_RECORD = record_of(PlantParameters)
"""`PlantParameters` as a record: numbers, and arrays (3,) where the tuple holds three."""


@njit(cache=True, forceinline=True)
def spring_deflection(parameters, leg, theta_m, theta_l):
    """Return the deflection that loads a leg's spring (rad, motor side): Eq. 19 less belt slip and backlash."""
    d = deflection(theta_m, theta_l, parameters.N) - parameters.slip[leg]
    return dead_zone(d, parameters.backlash + parameters.backlash_added[leg])


@njit(cache=True, forceinline=True)
def spring_stiffness(parameters, leg):
    """Return the stiffness (N m/rad) of a leg's spring: k_s as built, times its remaining share."""
    return parameters.k_s * parameters.k_s_share[leg]


@njit(cache=True, error_model="numpy", forceinline=True)
def series_share(parameters, leg):
    """Return the share (0 .. 1) of a spring's stiffness that remains with an elastic belt in series.

    A massless belt that yields by c per torque on the joint gives 1/k = 1/k_s + N^2 c on the motor's side.
    """
    return 1.0 / (1.0 + spring_stiffness(parameters, leg) * parameters.N * parameters.N * parameters.belt_compliance)


@njit(cache=True, forceinline=True)
def has_effects(parameters):
    """Whether joints have friction, stops, hysteresis, elastic belts or a tilted mounting; else these are skipped."""
    p = parameters
    springs = (p.belt_compliance > 0.0) | (p.spring_hysteresis > 0.0) | (p.spring_stop < math.inf)
    joints = (p.joint_friction > 0.0) | (p.joint_lower > -math.inf) | (p.joint_upper < math.inf)
    return springs | joints | (p.mounting_tilt != 0.0) | (p.mounting_tilt_x != 0.0)


@njit(cache=True)
def loaded_deflection(parameters, anchors, leg, theta_m, theta_l):
    """Return the deflection (rad, motor side) of an ideal spring that gives the torque of the leg's real spring.

    The real spring may be at its stop, have hysteresis and be in series with an elastic belt.
    """
    d = stop_deflection(parameters, spring_deflection(parameters, leg, theta_m, theta_l))
    if parameters.spring_hysteresis > 0.0:
        d = hysteresis_deflection(parameters, anchors, leg, d)
    return series_share(parameters, leg) * d


@njit(cache=True)
def _push(parameters, anchors, leg, theta_l):
    """Return the torque (N m) of dry friction and hard stops on a leg's joint."""
    push = stop_torque(parameters, theta_l)
    return push - friction_torque(parameters, anchors, leg, theta_l) if parameters.joint_friction > 0.0 else push


@njit(cache=True, forceinline=True)
def head_sees(parameters, s_B):
    """Return the displacement (m) of the surface relative to the head, from the surface's displacement `s_B` (m)."""
    head = parameters.head
    return s_B[0] - head[0], s_B[1] - head[1], s_B[2] - head[2]


@njit(cache=True)
def settle_friction(parameters, x, theta_m, anchors):
    """Move the anchors of dry friction, in place, as dragged by the plant's state and motor angles."""
    for leg in range(3):
        k_r, k_z, _, _, _, _ = leg_vectors(parameters, leg, x[0], x[1], x[2])
        theta_l = angle_near(anchors, leg, k_r, k_z)
        d = stop_deflection(parameters, spring_deflection(parameters, leg, theta_m[leg], theta_l))
        drag(parameters, anchors, leg, theta_l, d)


@njit(cache=True, forceinline=True)
def joint_torque(parameters, leg, d, omega_l):
    """Return the torque tau_l (N m) of a leg's spring on its joint at deflection `d` (Eq. 20).

    The efficiency is constant, or depends on the direction of motion if `eta_rate` is positive.
    """
    k_s = spring_stiffness(parameters, leg)
    if parameters.eta_rate > 0.0:
        return directed_load_torque(k_s, parameters.N, parameters.eta, d, omega_l, parameters.eta_rate)
    return load_torque(k_s, parameters.N, parameters.eta, d)


@njit(cache=True, forceinline=True)
def _joint(parameters, anchors, leg, theta_m, theta_l, omega_l, k_r, k_z, up, special):
    """Return the total torque (N m) on a leg's joint: spring, damping, dry friction, stops, weight of the arm.

    theta_l, omega_l, k_r, k_z are `compiled.lanes` over all legs; the other arguments as in `acceleration`.
    """
    angle, speed, hangs = theta_l[leg], omega_l[leg], arm_weight(parameters)
    if special:
        d = loaded_deflection(parameters, anchors, leg, theta_m[leg], angle)
        push = hangs * gravity_lever(up, leg, k_r[leg], k_z[leg]) + _push(parameters, anchors, leg, angle)
    else:
        d, push = spring_deflection(parameters, leg, theta_m[leg], angle), hangs * k_r[leg]
    tau_l = joint_torque(parameters, leg, d, speed)
    return tau_l - (parameters.b_j + parameters.b_j_added[leg]) * speed + push


@njit(cache=True, forceinline=True)
def _lane_sum(start, lanes):
    return start + lanes[0] + lanes[1] + lanes[2]


# NumPy division: a robot without mass must give infinity, because an exception is lost in compiled code that the master
# calls by address
@njit(cache=True, error_model="numpy", forceinline=True)
def _solve_symmetric(a, b, c, d, e, f, x, y, z):
    """Solve the symmetric system [[a, b, c], [b, d, e], [c, e, f]] s = (x, y, z) by cofactors."""
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
    """Compute the platform's acceleration dv/dt (m/s^2) and the bristle's rate dz_b/dt (m/s), two tuples.

    Both are NaN outside the workspace, for lack of joint angles.

    Args:
        parameters: `PlantParameters`, or a record of them.
        p, v: position (m) and velocity (m/s) of the platform, triples.
        z_b: bristle deflection (m), a pair.
        theta_m: motor angles (rad), a triple.
        s_B, v_s_B: displacement (m) and velocity (m/s) of the surface relative to the head (`head_sees`), triples; it
            does not rotate.
        apex: see `touch`.
        anchors: reference angles of the joints, see `angle_near`, and of dry friction, see `joints.py`.
        special: result of `has_effects`, evaluated once per step rather than here.
    """
    # motion of the platform relative to the surface
    rx, ry, rz = p[0] - s_B[0], p[1] - s_B[1], p[2] - s_B[2]
    ux, uy, uz = v[0] - v_s_B[0], v[1] - v_s_B[1], v[2] - v_s_B[2]
    contact_x, contact_y, contact_z, _, dz_1, dz_2 = touch(parameters, apex, rx, ry, rz, ux, uy, uz, z_b[0], z_b[1])
    pushed = acceleration_against(parameters, p, v, theta_m, (contact_x, contact_y, contact_z), anchors, special)
    return pushed, (dz_1, dz_2)


@njit(cache=True, error_model="numpy", forceinline=True)
def acceleration_against(parameters, p, v, theta_m, F_ee_B, anchors, special):
    """Compute the acceleration dv/dt (m/s^2) of a platform that exerts the given force `F_ee_B` (N).

    The other arguments as in `acceleration`.
    """
    x, y, z = p
    vx, vy, vz = v
    inertia, sixth = leg_inertia(parameters, parameters), parameters.m_b / 6.0
    up, weight = (0.0, 0.0, 1.0), platform_weight(parameters)
    fx, fy, fz = -F_ee_B[0], -F_ee_B[1], -F_ee_B[2] - weight
    if special:
        up = upward(parameters)
        fx, fy, fz = fx - weight * up[0], fy - weight * up[1], -F_ee_B[2] - weight * up[2]
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
    fx, fy = _lane_sum(fx, C * f_r - S * f_w), _lane_sum(fy, S * f_r + C * f_w)
    fz = _lane_sum(fz, j_z * tau + sixth * (k_r * kappa + k_z * square))
    # I_a/2 J_i + m_b/6 d_i; M contains its product with J_i, and the transpose
    a_r, a_w, a_z = 0.5 * inertia * j_r + sixth * k_z, 0.5 * inertia * j_w, 0.5 * inertia * j_z - sixth * k_r
    jx, jy = C * j_r - S * j_w, S * j_r + C * j_w
    ax, ay = C * a_r - S * a_w, S * a_r + C * a_w
    m, zero = moving_mass(parameters), 0.0
    m11, m12, m13 = (
        _lane_sum(m, 2.0 * ax * jx),
        _lane_sum(zero, ax * jy + ay * jx),
        _lane_sum(zero, ax * j_z + a_z * jx),
    )
    m22, m23, m33 = _lane_sum(m, 2.0 * ay * jy), _lane_sum(zero, ay * j_z + a_z * jy), _lane_sum(m, 2.0 * a_z * j_z)
    return _solve_symmetric(m11, m12, m13, m22, m23, m33, fx, fy, fz)


@njit(cache=True)
def derivative(parameters, x, theta_m, s_B, v_s_B, dx):
    """Compute the derivative dx/dt of the plant's state (8,) into `dx`, without dry friction.

    The other arguments as in `acceleration`.
    """
    derivative_near(parameters, x, theta_m, s_B, v_s_B, INITIAL_ANCHORS, dx)


@njit(cache=True)
def derivative_near(parameters, x, theta_m, s_B, v_s_B, anchors, dx):
    """Compute the derivative dx/dt of the plant's state into `dx`, with dry friction at the given anchors."""
    p, v, z_b, s_B = (x[0], x[1], x[2]), (x[3], x[4], x[5]), (x[6], x[7]), head_sees(parameters, s_B)
    dx[0], dx[1], dx[2] = v
    dv, dz = acceleration(parameters, p, v, z_b, theta_m, s_B, v_s_B, apex_frame(parameters), anchors)
    dx[3], dx[4], dx[5] = dv
    dx[6], dx[7] = dz
