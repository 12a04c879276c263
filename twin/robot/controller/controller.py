"""The paper's controller (Fig. 3 B-D): robot model, estimator, force-position law, waypoints.

It uses its own model of the robot, not the plant's parameters. The estimator computes position and force from encoder
counts alone (Fig. 3 C, D): kinematics, then statics, with one Jacobian for both.

The law is hybrid force-position control (Fig. 3 B): the outer force loop shifts the z reference of the inner position
loop. The position loop converts the Cartesian error to motor speeds, omega_ref = N J PID(p_cmd - p_est). The force loop
is triggered by the pressing force F_z, or at a set time, and stays on: dp_z = -PID(F_z_ref - F_z), within +-limit.

The waypoints also exist as a separate component, for a third-party controller without its own reference.
"""

from collections.abc import Sequence
from functools import cache

import numpy as np

from twin.kernel.compiled.function import carray, njit
from twin.kernel.cosim.component import NativeComponent, address_of, doubles_at, step_function
from twin.kernel.cosim.port import Port, memory_of, port_record, record, record_of, state, states
from twin.kernel.settings import FieldSource, Values, fields_of_form, setting_fields
from twin.robot.controller.adaptive import ADAPTIVE_OUTPUTS, AdaptiveOptions, adapt, with_adaptive, write_outputs
from twin.robot.controller.pid import (
    LOW_PASS_RECORD,
    PID_RECORD,
    ForceLoop,
    Gains,
    Processor,
    accept,
    cached_share,
    loop_record,
    proposal,
)
from twin.robot.mechanism.geometry import Model
from twin.robot.mechanism.kinematics import jacobian_row, platform_position
from twin.robot.mechanism.statics import arm_gravity_torque, dead_zone, deflection, load_torque, platform_weight

ESTIMATOR_INPUTS = (Port("count_m", 3, "1", "motor encoder counts"), Port("count_l", 3, "1", "joint encoder counts"))
ESTIMATOR_OUTPUTS = (
    Port("theta_m", 3, "rad", "motor angles, from counts"),
    Port("theta_l", 3, "rad", "proximal link angles, from counts"),
    Port("p_B", 3, "m", "platform position by forward kinematics, base frame B"),
    Port("J", 9, "rad/m", "Jacobian d theta_l / d p_B at p_B, row by row"),
    Port("tau_l", 3, "N m", "joint torques by Eq. 20"),
    Port("F_ee_B", 3, "N", "force by the robot on the environment by statics, base frame B, unfiltered"),
    Port("valid", 1, "1", "whether these follow from the newest counts; if not, from the last that fit a pose", "bool"),
)
ESTIMATE_RECORD = port_record(ESTIMATOR_OUTPUTS[:-1])
"""All outputs except `valid`."""
ESTIMATE_SIZE = ESTIMATE_RECORD.itemsize // 8
NO_POSE = 2
LAW_INPUTS = (
    Port("p_B", 3, "m", "estimated platform position"),
    Port("J", 9, "rad/m", "Jacobian at the estimated position, row by row"),
    Port("F_ee_B", 3, "N", "estimated force by the robot on the environment"),
)
OMEGA_REF = Port("omega_ref", 3, "rad/s", "commanded motor speeds")
SHARE_PORT = Port(
    "share", 1, "1", "of the motor speeds commanded in the call before, what an energy tank has passed on"
)
LAW_OUTPUTS = (
    OMEGA_REF,
    Port("p_ref_B", 3, "m", "pre-defined reference position"),
    Port("p_cmd_B", 3, "m", "reference of the position loop: p_ref_B shifted by the force loop"),
    Port("dp_z", 1, "m", "correction of the force loop to the z reference; negative presses harder"),
    Port("triggered", 1, "1", "whether the force loop is on", "bool"),
    Port("F_z", 1, "N", "estimated pressing force, low-passed: what trigger and force loop use"),
    Port("F_z_ref", 1, "N", "reference of the force loop"),
)
P_REF_B = next(port for port in LAW_OUTPUTS if port.name == "p_ref_B")
WAY_MEMORY = record(segment=state("i8", below="way_points"), way_points="i8", times="i8", points="i8")
Ports = tuple[Port, ...]


class Belief(
    Values,
    parts=(
        setting_fields(Model),
        {name: FieldSource(Model, name, broken_by=(f"belief_{name}",)) for name in ("k_s", "eta")},
        setting_fields(Model, into="encoders"),
        setting_fields(Processor, "dead_zone"),
    ),
):
    """The robot model that the controller believes, SI: [controller.model] and the springs' dead zone `backlash`.

    `backlash` is the half width of the dead zone on the motor's side; 0 for the paper's estimator, which ignores it.
    """


BELIEF_RECORD = record_of(Belief)


ESTIMATOR_MEMORY = record(
    belief=BELIEF_RECORD, gravity_compensation="i8", **states(estimated="i8", newest=ESTIMATE_RECORD)
)


@njit(cache=True)
def angle(count, counts_per_turn, zero):
    """Convert an encoder count to an angle (rad)."""
    return count * (2.0 * np.pi / counts_per_turn) - zero


@njit(cache=True)
def estimate(belief, gravity_compensation, count_m, count_l, y):
    """Estimate position and force of the end-effector from encoder counts; NaN where no pose fits the counts.

    The counts of motors and joints are (3,) each; the result is written to the record `y` of `ESTIMATE_RECORD`.

    The believed dead zone of the springs is subtracted from the deflection. F_ee_B = J^T (tau_l + arm gravity) - weight
    e_z: Eq. 21-27 corrected and gravity-compensated; without compensation J^T tau_l, the paper's own form.
    """
    for i in range(3):
        y.theta_m[i] = angle(count_m[i], belief.motor_counts, belief.motor_zero[i])
        y.theta_l[i] = angle(count_l[i], belief.joint_counts, belief.joint_zero[i])
    px, py, pz = platform_position(belief, y.theta_l[0], y.theta_l[1], y.theta_l[2])
    y.p_B[0], y.p_B[1], y.p_B[2] = px, py, pz
    fx, fy, fz = 0.0, 0.0, -platform_weight(belief) if gravity_compensation else 0.0
    for i in range(3):
        theta_l = y.theta_l[i]
        jx, jy, jz = jacobian_row(belief, i, theta_l, px, py, pz)
        y.J[3 * i], y.J[3 * i + 1], y.J[3 * i + 2] = jx, jy, jz
        loaded = dead_zone(deflection(y.theta_m[i], theta_l, belief.N), belief.backlash)
        tau = load_torque(belief.k_s, belief.N, belief.eta, loaded)
        y.tau_l[i] = tau
        if gravity_compensation:
            tau += arm_gravity_torque(belief, belief, theta_l)
        fx, fy, fz = fx + jx * tau, fy + jy * tau, fz + jz * tau
    y.F_ee_B[0], y.F_ee_B[1], y.F_ee_B[2] = fx, fy, fz


@step_function(ESTIMATOR_MEMORY, ESTIMATOR_INPUTS, ESTIMATOR_OUTPUTS)
def estimator_step(m, t, h, u, y):
    estimate(m.belief, m.gravity_compensation, u.count_m, u.count_l, m.newest)
    newest = carray(doubles_at(address_of(m.newest)), ESTIMATE_SIZE)
    # the sum is NaN or infinite if any value is: a lost or corrupt sample must not disturb the controller
    y.valid = np.isfinite(np.sum(newest))
    if y.valid:
        given = carray(doubles_at(address_of(y)), ESTIMATE_SIZE)
        for i in range(ESTIMATE_SIZE):
            given[i] = newest[i]
        m.estimated = 1
    return 0 if m.estimated else NO_POSE


class Estimator(NativeComponent):
    """Sampled component of the paper's estimator: encoder counts in, position and force out; `period` in ticks."""

    def __init__(self, belief: Belief, gravity_compensation: bool = True, period: int = 1):
        memory = memory_of(ESTIMATOR_MEMORY, belief=tuple(belief), gravity_compensation=gravity_compensation)
        super().__init__("estimator", ESTIMATOR_INPUTS, ESTIMATOR_OUTPUTS, True, estimator_step, memory, period=period)

    def explain(self, status: int) -> str:
        return "found no pose that fits the first encoder counts"


def controller_ports(inputs: Ports, outputs: Ports, adaptive: bool, tank: bool) -> tuple[Ports, Ports]:
    """Return input and output ports of a controller, with or without adaptive options and an energy tank."""
    return inputs + (SHARE_PORT,) * tank, outputs + ADAPTIVE_OUTPUTS * adaptive


class Law(
    Values, parts=(setting_fields(Model, "N"), setting_fields(Processor, "speed_limit"), setting_fields(ForceLoop))
):
    """Settings of the force-position law, SI: believed belt ratio, limits, and the trigger of the force loop.

    It starts at a pressing force F_z above `trigger_force`, as in the caption of Fig. 4, or at `trigger_time`; infinity
    disables either. A pulling force never starts it.
    """


LAW_RECORD = record_of(Law)
LAW_MEMORY = record(
    law=LAW_RECORD,
    force=PID_RECORD,
    position=(PID_RECORD, (3,)),
    low=state(LOW_PASS_RECORD),
    lead=state("3f8"),
    F_z=state("f8"),
    triggered=state("i8"),
    segment=state("i8", below="way_points"),
    **fields_of_form("i8", "way_points times points"),
)


@njit(cache=True)
def reference_position(times, points, segment, t):
    """Interpolate the reference trajectory linearly at time `t` (s); return the point and segment, (x, y, z, segment).

    It is constant before the first and after the last waypoint.

    Args:
        times, points: waypoints, (n,) s ascending and (n, 3) m.
        segment: any index at or before the right one, such as the one returned last.
    """
    last = times.shape[0] - 1
    while segment < last and t >= times[segment + 1]:
        segment += 1
    if segment == last or t <= times[0]:
        return points[segment, 0], points[segment, 1], points[segment, 2], segment
    share = (t - times[segment]) / (times[segment + 1] - times[segment])
    a, b = points[segment], points[segment + 1]
    return (
        a[0] + share * (b[0] - a[0]),
        a[1] + share * (b[1] - a[1]),
        a[2] + share * (b[2] - a[2]),
        segment,
    )


@njit(cache=True)
def force_correction(law, pid, e, h):
    """Return the shift dp_z (m) of the z reference by the force loop for the force error `e` = F_z_ref - F_z (N)."""
    u, integral = proposal(pid, e, h)
    if abs(u) <= law.dp_z_max:
        accept(pid, integral)
    return -min(max(u, -law.dp_z_max), law.dp_z_max)


@njit(cache=True, error_model="numpy")
def unwind_integral(pid, z, share, h):
    """Reduce the force loop's integral if an energy tank has withheld a part of the last command.

    This back-calculation prevents windup, within half of the integral's own time kp/ki (Åström and Hägglund 2006,
    Advanced PID Control, Sec. 3.5). Upward motion is never withheld.

    Args:
        z: error of the position loop in the previous call (m); negative for a downward motion.
        share: share of that command that was passed on.
    """
    if share < 1.0 and pid.started and z < 0.0 and pid.ki > 0.0:
        pid.integral += (1.0 - share) * min(2.0 * pid.ki * h / pid.kp, 1.0) * z


@njit(cache=True)
def motor_speeds(law, pids, J, p_B, p_cmd_B, lead, h, omega_ref):
    """Compute the motor speeds omega_ref (3,), rad/s, that move the platform from `p_B` to `p_cmd_B` (3,), m.

    The feed-forward `lead` (3,), rad/s, is added; each speed is limited to +-omega_max.
    """
    ux, ix = proposal(pids[0], p_cmd_B[0] - p_B[0], h)
    uy, iy = proposal(pids[1], p_cmd_B[1] - p_B[1], h)
    uz, iz = proposal(pids[2], p_cmd_B[2] - p_B[2], h)
    within = True
    for i in range(3):
        omega = law.N * (J[3 * i] * ux + J[3 * i + 1] * uy + J[3 * i + 2] * uz) + lead[i]
        within = within and abs(omega) <= law.omega_max
        omega_ref[i] = min(max(omega, -law.omega_max), law.omega_max)
    if within:
        accept(pids[0], ix)
        accept(pids[1], iy)
        accept(pids[2], iz)


@njit(cache=True, inline="always")
def control(m, t, h, u, y, shift):
    """Execute one call of the force-position law, with its z reference additionally shifted by `shift` (m)."""
    times, points = carray(doubles_at(m.times), m.way_points), carray(doubles_at(m.points), (m.way_points, 3))
    p_ref_B = y.p_ref_B
    p_ref_B[0], p_ref_B[1], p_ref_B[2], m.segment = reference_position(times, points, m.segment, t)
    m.F_z += cached_share(m.low, m.law.corner, h) * (-u.F_ee_B[2] - m.F_z)
    if m.F_z > m.law.trigger_force or t >= m.law.trigger_time - 0.5 * h:
        m.triggered = 1
    y.dp_z = force_correction(m.law, m.force, m.law.F_z_ref - m.F_z, h) if m.triggered else 0.0
    y.p_cmd_B[0], y.p_cmd_B[1], y.p_cmd_B[2] = p_ref_B[0], p_ref_B[1], p_ref_B[2] + y.dp_z + shift
    motor_speeds(m.law, m.position, u.J, u.p_B, y.p_cmd_B, m.lead, h, y.omega_ref)
    y.triggered, y.F_z, y.F_z_ref = m.triggered, m.F_z, m.law.F_z_ref


ADAPTIVE_MEMORY = with_adaptive(LAW_MEMORY)


@cache
def make_step(adaptive, tank):
    """Compile the step function of the paper's controller, with or without adaptive options and an energy tank."""

    @step_function(
        ADAPTIVE_MEMORY if adaptive else LAW_MEMORY, *controller_ports(LAW_INPUTS, LAW_OUTPUTS, adaptive, tank)
    )
    def step(m, t, h, u, y):
        shift = 0.0
        if tank:
            unwind_integral(m.force, m.position[2].error, u.share, h)
        if adaptive:
            adapt(m.adaptive, m.gain_table, m.force, h, u.p_B[2], -u.F_ee_B[2], u.J, m.law.F_z_ref)
            for i in range(3):
                m.lead[i] = m.law.N * u.J[3 * i + 2] * m.adaptive.v_shift
            shift = m.adaptive.shift
        control(m, t, h, u, y, shift)
        if adaptive:
            write_outputs(m.adaptive, m.force, m.triggered, y)
        return 0

    return step


class Controller(NativeComponent):
    """Sampled component of the paper's controller: position and force estimates in, motor speeds out.

    Args:
        position, force: gains of the two loops; position acts on m and gives m/s, force acts on N and gives m.
        times, points: waypoints of the reference, (n,) s ascending and (n, 3) m.
        period: period in ticks.
        adapting: adaptive options; None for the paper's law alone.
        tank: whether an energy tank behind it reports the share that it passes on.

    Attributes:
        points: waypoints (n, 3) that the step reads.
    """

    def __init__(
        self,
        law: Law,
        position: Gains,
        force: Gains,
        times: Sequence[float],
        points: Sequence[Sequence[float]],
        period: int = 1,
        adapting: AdaptiveOptions | None = None,
        tank: bool = False,
    ):
        times_, points_ = np.array(times, dtype=float), np.array(points, dtype=float)
        memory = memory_of(
            ADAPTIVE_MEMORY if adapting else LAW_MEMORY,
            law=tuple(law),
            force=loop_record(force),
            position=[loop_record(position)] * 3,
        )
        memory["way_points"] = len(times_)
        arrays = {"times": times_, "points": points_}
        if adapting:
            arrays |= adapting.fill(memory["adaptive"][0])
        variant = adapting is not None, tank
        self.points = points_
        sides = controller_ports(LAW_INPUTS, LAW_OUTPUTS, *variant)
        super().__init__("controller", *sides, True, make_step(*variant), memory, period=period, pointers=arrays)


@step_function(WAY_MEMORY, outputs=(P_REF_B,))
def way_step(m, t, h, u, y):
    times, points = carray(doubles_at(m.times), m.way_points), carray(doubles_at(m.points), (m.way_points, 3))
    p = y.p_ref_B
    p[0], p[1], p[2], m.segment = reference_position(times, points, m.segment, t)
    return 0


class WayPointReference(NativeComponent):
    """Sampled component that outputs the point of the reference trajectory at each sample; see `Controller`."""

    def __init__(self, times: Sequence[float], points: Sequence[Sequence[float]], period: int = 1):
        arrays = np.array(times, dtype=float), np.array(points, dtype=float)
        self.points = arrays[1]
        memory = np.array([(0, len(arrays[0]), arrays[0].ctypes.data, arrays[1].ctypes.data)], dtype=WAY_MEMORY)
        super().__init__("reference", (), (P_REF_B,), True, way_step, memory, period=period, keep=arrays)
