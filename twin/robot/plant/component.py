"""The plant as a co-simulation component, and its state at rest.

The step is classical Runge-Kutta over a tick, friction settled after each step. A moving surface continues at constant
velocity within a tick, s_k + v_k (t - t_k). The motors are held at their angles at the end of the tick or, in a ramp,
turn there from their angles at its start.
"""

import math
from functools import cache

import numpy as np
from numpy.typing import ArrayLike, NDArray

from twin.kernel.compiled.function import njit
from twin.kernel.compiled.native import entry
from twin.kernel.cosim.component import NativeComponent, step_function
from twin.kernel.cosim.port import Port, memory_of, port_record, record, state
from twin.robot.mechanism.geometry import Geometry, angles_near, coordinates_along, leg_motion, legs, links, move_anchor
from twin.robot.mechanism.kinematics import jacobian, joint_angles
from twin.robot.mechanism.statics import motor_load_torque, platform_weight
from twin.robot.plant.contact import apex_frame, contact_force, normal_force, settled_bristle, touch
from twin.robot.plant.dynamics import (
    INITIAL_ANCHORS,
    PARAMETERS_RECORD,
    STATE_SIZE,
    PlantParameters,
    acceleration,
    has_effects,
    head_sees,
    joint_torque,
    loaded_deflection,
    series_share,
    settle_friction,
    spring_deflection,
    spring_stiffness,
)
from twin.robot.plant.joints import ANCHOR_SIZE, arm_torque, inverse_stop_deflection, stop_torque, upward

LEFT_WORKSPACE = 2

PLANT_INPUTS = (Port("theta_m", 3, "rad", "motor angles, held over the step; in a ramp, at its end", instant="end"),)
RAMP_INPUTS = (Port("theta_m_start", 3, "rad", "motor angles at the start of the step", instant="start"),)
GROUND_INPUTS = (
    Port("s_B", 3, "m", "displacement of the surface in base frame B, at the start of the step"),
    Port("v_s_B", 3, "m/s", "velocity of the surface in base frame B, held over the step"),
)
PLANT_OUTPUTS = (
    Port("p_B", 3, "m", "platform position in base frame B"),
    Port("v_B", 3, "m/s", "platform velocity in base frame B"),
    Port("theta_l", 3, "rad", "proximal link angles, positive lowers the platform"),
    Port("omega_l", 3, "rad/s", "proximal link speeds"),
    Port("tau_l", 3, "N m", "torque of the springs on the joints"),
    Port("tau_load", 3, "N m", "torque the springs ask of the motor shafts, tau_l / (N eta)"),
    Port("F_ee_B", 3, "N", "force by the robot on the surface in base frame B; pressing has F_ee_B[2] < 0"),
    Port("F_n", 1, "N", "normal contact force"),
    Port("z_b", 2, "m", "bristle deflection in the surface"),
)
PLANT_MEMORY = record(
    parameters=PARAMETERS_RECORD,
    substeps="i8",
    x=state(("f8", (STATE_SIZE,))),
    anchors=state(("f8", (3, ANCHOR_SIZE))),
    last=state(("f8", (STATE_SIZE,))),
)
NO_MOTION = (0.0, 0.0, 0.0)
"""Displacement and velocity of a surface at rest, or speeds of motors at rest."""
OUTPUTS_RECORD = port_record(PLANT_OUTPUTS)
_REST_RECORD = record(
    parameters=PARAMETERS_RECORD, **dict.fromkeys(("p_B", "theta_l", "wrench", "arms", "stops", "tau_l", "d"), "3f8")
)
"""Wrench (N) carried by the joints at p_B, torques (N m) of weights and stops, and of the springs, and their
deflections."""


def plant_inputs(moving: bool, ramp: bool) -> tuple[Port, ...]:
    """Return the input ports of the plant, with or without a moving surface, and motors that turn within the step."""
    return PLANT_INPUTS + GROUND_INPUTS * moving + RAMP_INPUTS * ramp


@njit(cache=True)
def extrapolate(s, v, t):
    """Return the triple `s` after `t` seconds at the constant rates `v`."""
    return s[0] + t * v[0], s[1] + t * v[1], s[2] + t * v[2]


@njit(cache=True)
def settle(parameters, apex, x, s_B, v_s_B):
    """Scale the friction bristle in the plant's state back onto the friction cone, in place.

    This return mapping is applied at the end of every integration step.
    """
    _settle(parameters, apex, x, head_sees(parameters, s_B), v_s_B)


@njit(cache=True, forceinline=True)
def _settle(parameters, apex, x, s_B, v_s_B):
    F_n, _ = normal_force(
        parameters,
        apex,
        x[0] - s_B[0],
        x[1] - s_B[1],
        x[2] - s_B[2],
        x[3] - v_s_B[0],
        x[4] - v_s_B[1],
        x[5] - v_s_B[2],
    )
    x[6], x[7] = settled_bristle(parameters, F_n, x[6], x[7])


@njit(cache=True)
def extrapolate_pair(a, rate, t):
    """Return the pair `a` after `t` seconds at constant rates."""
    return a[0] + t * rate[0], a[1] + t * rate[1]


@njit(cache=True, forceinline=True)
def runge_kutta_mean(a, b, c, d):
    """Return the weighted mean of the four rates of a classical Runge-Kutta step."""
    return (a + 2.0 * b + 2.0 * c + d) / 6.0


@njit(cache=True)
def integrate(parameters, x, theta_m, omega_m, s_B, v_s_B, h, apex, anchors):
    """Integrate the plant's state in place by one classical Runge-Kutta step of `h` seconds.

    The motors start at the triple `theta_m` (rad) and turn at `omega_m` (rad/s), the surface starts at `s_B` (m) and
    moves at `v_s_B` (m/s); `apex` and `anchors` as in `acceleration`.
    """
    half = 0.5 * h
    special, s_B = has_effects(parameters), head_sees(parameters, s_B)
    theta_half, theta_end = extrapolate(theta_m, omega_m, half), extrapolate(theta_m, omega_m, h)
    s_half, s_end = extrapolate(s_B, v_s_B, half), extrapolate(s_B, v_s_B, h)
    p, v, z = (x[0], x[1], x[2]), (x[3], x[4], x[5]), (x[6], x[7])
    a, r = acceleration(parameters, p, v, z, theta_m, s_B, v_s_B, apex, anchors, special)
    v_2 = extrapolate(v, a, half)
    a_2, r_2 = acceleration(
        parameters,
        extrapolate(p, v, half),
        v_2,
        extrapolate_pair(z, r, half),
        theta_half,
        s_half,
        v_s_B,
        apex,
        anchors,
        special,
    )
    v_3 = extrapolate(v, a_2, half)
    a_3, r_3 = acceleration(
        parameters,
        extrapolate(p, v_2, half),
        v_3,
        extrapolate_pair(z, r_2, half),
        theta_half,
        s_half,
        v_s_B,
        apex,
        anchors,
        special,
    )
    v_4 = extrapolate(v, a_3, h)
    a_4, r_4 = acceleration(
        parameters,
        extrapolate(p, v_3, h),
        v_4,
        extrapolate_pair(z, r_3, h),
        theta_end,
        s_end,
        v_s_B,
        apex,
        anchors,
        special,
    )
    for i in range(3):
        x[i] += h * runge_kutta_mean(v[i], v_2[i], v_3[i], v_4[i])
        x[3 + i] += h * runge_kutta_mean(a[i], a_2[i], a_3[i], a_4[i])
    for i in range(2):
        x[6 + i] += h * runge_kutta_mean(r[i], r_2[i], r_3[i], r_4[i])
    _settle(parameters, apex, x, s_end, v_s_B)
    if special:
        settle_friction(parameters, x, theta_end, anchors)


@njit(cache=True, error_model="numpy")
def outputs_near(parameters, x, theta_m, s_B, v_s_B, apex, anchors, y):
    """Compute the plant's outputs from its state and motor angles; return False outside the workspace.

    The surface is at the triple `s_B` (m) and moves at `v_s_B` (m/s); `apex` and `anchors` as in `acceleration`.
    Anchors too far from this state are moved.
    """
    px, py, pz, vx, vy, vz = x[0], x[1], x[2], x[3], x[4], x[5]
    # copied one by one: copying a slice allocates memory, in case it overlaps, which an exported step must not do
    for i in range(3):
        y.p_B[i], y.v_B[i] = x[i], x[3 + i]
    y.z_b[0], y.z_b[1] = x[6], x[7]
    # NaN if a leg could not reach the platform within a step
    inside = not math.isnan(vx + vy + vz)
    special, s_B = has_effects(parameters), head_sees(parameters, s_B)
    C, S = legs()
    u, w = coordinates_along(parameters, C, S, px, py)
    k_r, k_z, r, w, h, q = links(parameters, u, w, pz)
    for leg in range(3):
        move_anchor(parameters, anchors, leg, k_r[leg], k_z[leg])
    angles = angles_near(anchors, k_r, k_z)
    _, _, _, speeds, _ = leg_motion(parameters, k_r, k_z, r, w, h, q, C * vx + S * vy, C * vy - S * vx, vz)
    for leg in range(3):
        theta_l, omega_l = angles[leg], speeds[leg]
        inside = inside and not math.isnan(theta_l)
        if special:
            d = loaded_deflection(parameters, anchors, leg, theta_m[leg], theta_l)
        else:
            d = spring_deflection(parameters, leg, theta_m[leg], theta_l)
        y.theta_l[leg] = theta_l
        y.omega_l[leg] = omega_l
        y.tau_l[leg] = joint_torque(parameters, leg, d, omega_l)
        y.tau_load[leg] = motor_load_torque(spring_stiffness(parameters, leg), d)
    rx, ry, rz = px - s_B[0], py - s_B[1], pz - s_B[2]
    ux, uy, uz = vx - v_s_B[0], vy - v_s_B[1], vz - v_s_B[2]
    fx, fy, fz, y.F_n, _, _ = touch(parameters, apex, rx, ry, rz, ux, uy, uz, x[6], x[7])
    y.F_ee_B[0], y.F_ee_B[1], y.F_ee_B[2] = fx, fy, fz
    return inside


@njit(cache=True)
def triple(v):
    """Convert an input port of three values to a tuple."""
    return v[0], v[1], v[2]


@cache
def make_step(moving, ramp):
    """Compile the step function of the plant, with or without a moving surface, and motors turning within the step."""

    @step_function(PLANT_MEMORY, plant_inputs(moving, ramp), PLANT_OUTPUTS)
    def step(m, t, h, u, y):
        theta_m = start = triple(u.theta_m)
        s_B = v_s_B = omega_m = NO_MOTION
        if moving:
            s_B, v_s_B = triple(u.s_B), triple(u.v_s_B)
        if ramp:
            start = triple(u.theta_m_start)
            omega_m = (theta_m[0] - start[0]) / h, (theta_m[1] - start[1]) / h, (theta_m[2] - start[2]) / h
        # last valid state, for the error message of a step that leaves only NaN
        for i in range(STATE_SIZE):
            m.last[i] = m.x[i]
        substep = h / m.substeps
        apex = apex_frame(m.parameters)
        for i in range(m.substeps):
            turned = extrapolate(start, omega_m, i * substep)
            s_now = extrapolate(s_B, v_s_B, i * substep)
            integrate(m.parameters, m.x, turned, omega_m, s_now, v_s_B, substep, apex, m.anchors)
        inside = outputs_near(m.parameters, m.x, theta_m, extrapolate(s_B, v_s_B, h), v_s_B, apex, m.anchors, y)
        return 0 if inside else LEFT_WORKSPACE

    return step


@entry("nothing", PLANT_MEMORY, "doubles", OUTPUTS_RECORD, at_once=True)
def _begin(m, theta_m, y):
    turned = triple(theta_m)
    settle_friction(m.parameters, m.x, turned, m.anchors)
    outputs_near(m.parameters, m.x, turned, NO_MOTION, NO_MOTION, apex_frame(m.parameters), m.anchors, y)


def _set_state(memory: NDArray, x: ArrayLike, theta_m: ArrayLike) -> NDArray[np.float64]:
    memory["x"], memory["anchors"] = x, INITIAL_ANCHORS
    y = np.empty(1, dtype=OUTPUTS_RECORD)
    _begin(memory, np.array(theta_m, dtype=float), y)
    return y.view(np.float64)


class Plant(NativeComponent):
    """Continuous component of the plant: springs, mechanism and contact.

    Args:
        parameters: true parameters.
        x: initial state (8,), see `STATE_SIZE`.
        theta_m: initial motor angles (3,), rad.
        substeps: Runge-Kutta steps per co-simulation step.
        moving: whether the inputs `GROUND_INPUTS` move the surface; before tick 0 it is at its place in `parameters`.
        ramp: whether the motors turn from the input `RAMP_INPUTS` to theta_m within the step.
    """

    def __init__(
        self,
        parameters: PlantParameters,
        x: ArrayLike,
        theta_m: ArrayLike,
        substeps: int = 1,
        moving: bool = False,
        ramp: bool = False,
    ):
        memory = memory_of(PLANT_MEMORY, parameters=tuple(parameters), substeps=substeps)
        super().__init__(
            "plant", plant_inputs(moving, ramp), PLANT_OUTPUTS, False, make_step(moving, ramp), memory,
            _set_state(memory, x, theta_m),
        )  # fmt: skip

    def set_state(self, x: ArrayLike, theta_m: ArrayLike) -> NDArray[np.float64]:
        """Set the plant's state and motor angles, with dry friction at rest; return the outputs there."""
        return _set_state(self.memory, x, theta_m)

    def explain(self, status: int) -> str:
        x, y, z = 1e3 * self.memory["last"][0][:3]
        return f"left the workspace: a leg cannot reach the platform near ({x:.1f}, {y:.1f}, {z:.1f}) mm,"


@entry("nothing", _REST_RECORD)
def _load(m):
    p, (x, y, z) = m.parameters, (m.p_B[0], m.p_B[1], m.p_B[2])
    up, weight = upward(p), platform_weight(p)
    force = contact_force(p, x, y, z, 0.0, 0.0, 0.0, 0.0, 0.0)
    for i in range(3):
        m.wrench[i] = force[i] + weight * up[i]
        m.arms[i], m.stops[i] = arm_torque(p, up, i, m.theta_l[i]), stop_torque(p, m.theta_l[i])


@entry("nothing", _REST_RECORD)
def _deflect(m):
    for leg in range(3):
        d = m.tau_l[leg] / joint_torque(m.parameters, leg, 1.0, 0.0)
        m.d[leg] = inverse_stop_deflection(m.parameters, d / series_share(m.parameters, leg))


def rest_state(parameters: PlantParameters, p_B: ArrayLike) -> tuple[np.ndarray, np.ndarray]:
    """Compute the plant's state (8,) and motor angles (3,) with the platform at rest at `p_B` (3,), m.

    The net force on the platform is zero with velocities and bristle zero; a loaded spring is at the far side of its
    backlash, an unloaded one in the middle. Deflections follow from `joint_torque` at speed zero, where losses in the
    direction of the power flow (P1) vanish. Dry friction is unloaded, in the middle of its range. No spring may be
    broken, as no other part would carry its share.

    Raises:
        Unreachable: `p_B` is outside the workspace.
    """
    p = np.asarray(p_B, dtype=float)
    geometry = Geometry(parameters.a, parameters.b, parameters.l_a, parameters.l_b)
    theta_l = joint_angles(geometry, p)
    rest = memory_of(_REST_RECORD, parameters=tuple(parameters), p_B=p, theta_l=theta_l)
    _load(rest)
    rest["tau_l"] = np.linalg.solve(jacobian(geometry, p).T, rest["wrench"][0]) - rest["arms"][0] - rest["stops"][0]
    _deflect(rest)
    d = rest["d"][0]
    backlash = parameters.backlash + np.array(parameters.backlash_added)
    theta_m = parameters.N * theta_l + d + np.sign(d) * backlash + np.array(parameters.slip)
    x = np.zeros(STATE_SIZE)
    x[:3] = p
    return x, theta_m
