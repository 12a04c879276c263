"""Safety monitor as a co-simulation component between controller and drives.

Pose, speeds and force come from its own belief and its own low-pass, so that an error in the controller's model is not
also the monitor's. The resolution of the encoders bounds the differences that it can detect.
"""

import math
from functools import cache
from typing import NamedTuple

import numpy as np
from numpy.typing import ArrayLike

from twin.kernel.compiled.function import njit
from twin.kernel.cosim.component import Component, NativeComponent, step_function
from twin.kernel.cosim.port import Port, by_port, memory_of, record, record_of, states, width
from twin.kernel.cosim.simulation import Simulation
from twin.kernel.cosim.system import System
from twin.kernel.settings import Values, fields_of_form, setting, setting_fields
from twin.robot.mechanism.geometry import Model, geometry_of
from twin.robot.mechanism.kinematics import jacobian, jacobian_row, joint_angles, platform_position
from twin.robot.mechanism.statics import (
    Masses,
    dead_zone,
    deflection,
    environment_force,
    force_on_environment,
    load_torque,
)
from twin.robot.monitor.checks import (
    MAX_COUNT,
    MAX_SAMPLE_NUMBER,
    REACHED_SHARE,
    TIMERS_RECORD,
    count_unusable,
    evaluate_command,
    evaluate_sample,
    first_violation,
    thresholds,
    update_timers,
)
from twin.robot.monitor.limits import LIMITS_RECORD, Limits
from twin.robot.monitor.reasons import REASON_COUNT, Reason, Trip, trip_message
from twin.robot.monitor.safe_action import (
    RETRACTION_RECORD,
    add_travel,
    close_brakes,
    enforce,
    mark_doubtful_encoders,
    retraction_speed,
    supervise,
    update_command_bounds,
)

MONITOR_INPUTS = (
    Port("count_m", 3, "1", "motor encoder counts"),
    Port("count_l", 3, "1", "joint encoder counts"),
    Port("sample", 1, "1", "number of the encoder message, one more with each"),
    Port("omega_ref", 3, "rad/s", "motor speeds that the controller commands"),
)
AGE_PORT = Port("age", 1, "s", "time since the last command took effect")
"""Additional input if the commands come from a remote controller."""
POWER_PORT = Port("power", 1, "1", "whether the drives may have power", "bool")
MONITOR_OUTPUTS = (
    Port("omega_ref", 3, "rad/s", "motor speeds for the drives: the controller's, after a trip the retraction's"),
    Port("tripped", 1, "1", "whether the monitor has tripped; stays", "bool"),
    Port("reason", 1, "1", "why, a code of docs/safety.md; 0: not tripped", "int"),
    POWER_PORT,
    Port("F_z", 1, "N", "pressing force by the monitor's own estimate, low-passed"),
    Port("speed", 1, "m/s", "speed of the platform, low-passed"),
    Port("depth", 1, "m", "how far the platform is below the place where the present contact began"),
    Port("contact_time", 1, "s", "duration of the present contact"),
    Port("utilisation", 1, "1", "largest share of any limit in use; 1 trips"),
)
LINE_PORTS = (
    Port("drive_power", 3, "1", "whether each drive may have power", "bool"),
    Port("brake", 1, "1", "whether brakes with a line of their own may close", "bool"),
)
"""Additional outputs if the experiment has drives with a power line each ([drive.unpowered])."""
OBSERVATION_RECORD = record(
    **states(
        started="i8",
        **fields_of_form("3f8", "theta_m theta_l"),
        **fields_of_form("3i8", "moved_m moved_l"),
        **fields_of_form(
            "3f8", "rate_m rate_l last_m deflection tau_l fastest omega_m omega_l omega_cmd p_B v_B F_ee_B"
        ),
        **fields_of_form("f8", "speed force force_rate"),
        touching="i8",
        **fields_of_form("f8", "z_touch depth"),
        contact_ticks="i8",
        **fields_of_form("3f8", "expected felt"),
        hidden_ticks="i8",
    ),
)
"""Newest observation: angles (rad), whether an encoder moved a count, speeds of the two angles since the sample
before (rad/s, the joint's on the motor's side), the motor's of the sample before (rad/s), deflection (rad), joint
torques (N m), fastest change since the sample before on the motor's side (rad/s); low-passed: motor speed, joint speed
on the motor's side and commanded speed (rad/s), velocity (m/s), speed (m/s), force (N) and the growth of its length
(N/s); position (m); the contact: initial height (m), depth below it (m), duration (ticks); motor speed expected from
the command without load (rad/s), motor load beyond the springs' torque, low-passed (N m at the joint), and its duration
as a hidden force (ticks)."""


class MonitorBelief(
    Values,
    parts=(
        setting_fields(Model),
        {"backlash": setting("rad", help="half width of the dead zone of the spring deflection, motor side")},
        setting_fields(Model, into="encoders"),
    ),
):
    """The monitor's own model of the robot, SI."""


BELIEF_RECORD = record_of(MonitorBelief)


class Resolution(NamedTuple):
    """Resolution of the monitor's estimates: worst-case effect of one count on every encoder at once, SI.

    Attributes:
        deflection: deflection of a spring on the motor's side (rad).
        motor_speed: one motor count from one sample to the next (rad/s).
        jump: motor and joint count together from one sample to the next (rad/s).
        force, force_rate: magnitude of the force (N), and the same per sample (N/s).
        position, velocity: position of the platform (m), and the same per sample (m/s).
    """

    deflection: float
    motor_speed: float
    jump: float
    force: float
    force_rate: float
    position: float
    velocity: float


def resolution(belief: MonitorBelief, p_B: ArrayLike, dt: float) -> Resolution:
    """Compute the effect of one count on every encoder on deflection, speed, force and position, at platform position
    `p_B` (3,), m, sampled every `dt` (s).

    F = J^T tau_l and v = J^-1 dtheta_l/dt; the worst case over the signs of the three joints is bounded by the sum of
    the lengths of the rows of J and of the columns of J^-1.

    Raises:
        Unreachable: `p_B` is outside the workspace.
    """
    J = jacobian(geometry_of(belief), p_B)
    motor, joint = 2.0 * np.pi / belief.motor_counts, 2.0 * np.pi / belief.joint_counts
    deflected = motor + belief.N * joint
    force = float(load_torque(belief.k_s, belief.N, belief.eta, deflected)) * float(np.linalg.norm(J, axis=1).sum())
    position = joint * float(np.linalg.norm(np.linalg.inv(J), axis=0).sum())
    return Resolution(
        deflection=deflected,
        motor_speed=motor / dt,
        jump=deflected / dt,
        force=force,
        force_rate=force / dt,
        position=position,
        velocity=position / dt,
    )


def press_deflection(belief: MonitorBelief, p_B: ArrayLike, force: float) -> float:
    """Compute the largest spring deflection (rad, motor side) of a robot pressing with `force` (N) at `p_B` (3,), m.

    tau_l = J^-T (F_ee_B + own weight) with F_ee_B = (0, 0, -force), and Eq. 20; plus the dead zone.

    Raises:
        Unreachable: `p_B` is outside the workspace.
    """
    shape = geometry_of(belief)
    theta_l, J = joint_angles(shape, p_B), jacobian(shape, p_B)
    masses = Masses(belief.m_a, belief.m_b, belief.m_p, 0.0)
    unloaded = force_on_environment(shape, masses, theta_l, p_B, np.zeros(3))
    tau_l = np.linalg.solve(J.T, np.array([0.0, 0.0, -force]) - unloaded)
    return float(np.abs(tau_l).max() / load_torque(belief.k_s, belief.N, belief.eta, 1.0) + belief.backlash)


@njit(cache=True)
def angle(count, counts_per_turn, zero):
    """Convert an encoder count to an angle (rad)."""
    return count * (2.0 * np.pi / counts_per_turn) - zero


@njit(cache=True)
def low_pass_share(corner, dt):
    """Compute the weight of a new sample in a first-order low-pass with `corner` (Hz) and step `dt` (s)."""
    return 1.0 - math.exp(-2.0 * math.pi * corner * dt)


@njit(cache=True, error_model="numpy")
def observe_joints(belief, seen, share, dt, count_m, count_l, sent):
    """Update the monitor's angles, speeds and torques of the three joints, `dt` (s) after the previous sample, from
    counts (3,) each and the commanded motor speeds `sent` (3,), rad/s, since then.

    An unusable count leaves its angle unchanged; that matters only after a trip, since the first one trips.
    """
    for i in range(3):
        theta_m = angle(count_m[i], belief.motor_counts, belief.motor_zero[i])
        theta_l = angle(count_l[i], belief.joint_counts, belief.joint_zero[i])
        # not >=: that would let NaN pass
        if not abs(count_m[i]) < MAX_COUNT:
            theta_m = seen.theta_m[i]
        if not abs(count_l[i]) < MAX_COUNT:
            theta_l = seen.theta_l[i]
        if seen.started:
            rate_m = (theta_m - seen.theta_m[i]) / dt
            rate_l = belief.N * (theta_l - seen.theta_l[i]) / dt
            seen.moved_m[i] = theta_m != seen.theta_m[i]
            seen.moved_l[i] = theta_l != seen.theta_l[i]
            seen.last_m[i], seen.rate_m[i], seen.rate_l[i] = seen.rate_m[i], rate_m, rate_l
            seen.fastest[i] = max(abs(rate_m), abs(rate_l), abs(rate_m - rate_l))
            seen.omega_m[i] += share * (rate_m - seen.omega_m[i])
            seen.omega_l[i] += share * (rate_l - seen.omega_l[i])
            seen.omega_cmd[i] += share * (sent[i] - seen.omega_cmd[i])
        seen.theta_m[i], seen.theta_l[i] = theta_m, theta_l
        seen.deflection[i] = deflection(theta_m, theta_l, belief.N)
        seen.tau_l[i] = load_torque(belief.k_s, belief.N, belief.eta, dead_zone(seen.deflection[i], belief.backlash))


@njit(cache=True, error_model="numpy")
def observe_platform(belief, seen, share, dt):
    """Update the estimates of platform position, velocity and force; return False, without changes, if no pose fits the
    joints.

    F_ee_B = J^T (tau_l + arm gravity) - weight e_z: Eq. 21-27 corrected and gravity-compensated.
    """
    x, y, z = platform_position(belief, seen.theta_l[0], seen.theta_l[1], seen.theta_l[2])
    p = (x, y, z)
    F = environment_force(belief, belief, seen.theta_l, p, seen.tau_l)
    # at the edge of the workspace the Jacobian is infinite
    if not math.isfinite(x + F[0] + F[1] + F[2]):
        return False
    if not seen.started:
        for i in range(3):
            seen.p_B[i], seen.F_ee_B[i] = p[i], F[i]
        seen.force = math.sqrt(F[0] * F[0] + F[1] * F[1] + F[2] * F[2])
        return True
    v2, F2 = 0.0, 0.0
    for i in range(3):
        seen.v_B[i] += share * ((p[i] - seen.p_B[i]) / dt - seen.v_B[i])
        seen.F_ee_B[i] += share * (F[i] - seen.F_ee_B[i])
        seen.p_B[i] = p[i]
        v2 += seen.v_B[i] * seen.v_B[i]
        F2 += seen.F_ee_B[i] * seen.F_ee_B[i]
    seen.speed = math.sqrt(v2)
    seen.force_rate = (math.sqrt(F2) - seen.force) / dt
    seen.force = math.sqrt(F2)
    return True


@njit(cache=True, error_model="numpy")
def update_hidden_force(limits, belief, seen, ticks, dt):
    """Update the monitor's estimate of the motor load beyond the springs' torque, and its duration as a hidden force.

    A drive whose speed droops by `drive_droop` (rad/s per N m) under load settles at omega_ref - droop tau_load (P12 of
    docs/equations.md). Command and motor encoder thus measure the load without the joint encoder; a drifting joint
    angle changes only the springs' torque. The low-pass, half of `hidden_time` long, averages out a wrong `drive_lag`.
    """
    lagging, share = 1.0 - math.exp(-dt / limits.drive_lag), 1.0 - math.exp(-2.0 * dt / limits.hidden_time)
    pressing = 0.0
    for i in range(3):
        seen.expected[i] += lagging * (seen.omega_cmd[i] - seen.expected[i])
        load = belief.N * belief.eta * (seen.expected[i] - seen.omega_m[i]) / limits.drive_droop
        seen.felt[i] += share * (load - seen.tau_l[i] - seen.felt[i])
        row = jacobian_row(belief, i, seen.theta_l[i], seen.p_B[0], seen.p_B[1], seen.p_B[2])
        pressing -= row[2] * seen.felt[i]
    seen.hidden_ticks = seen.hidden_ticks + ticks if pressing >= limits.hidden_force_limit else 0


@njit(cache=True)
def observe_contact(seen, contact_force, ticks):
    """Update the state of the contact, its depth and duration; a contact begins at `contact_force` (N) and ends at half
    of it."""
    F_z = -seen.F_ee_B[2]
    if not seen.touching and F_z >= contact_force:
        seen.touching = 1
        seen.z_touch = seen.p_B[2]
        seen.contact_ticks = 0
    elif seen.touching and F_z < 0.5 * contact_force:
        seen.touching = 0
    if seen.touching:
        seen.contact_ticks += ticks
        seen.depth = max(0.0, seen.z_touch - seen.p_B[2])
    else:
        seen.contact_ticks = 0
        seen.depth = 0.0


MONITOR_MEMORY = record(
    belief=BELIEF_RECORD,
    limits=LIMITS_RECORD,
    limit=("f8", (REASON_COUNT,)),
    rest=("f8", (REASON_COUNT,)),
    period="i8",
    sample_interval="i8",
    **states(**fields_of_form("i8", "tick first_tick first_sample sample")),
    seen=OBSERVATION_RECORD,
    timers=TIMERS_RECORD,
    **states(values=("f8", (REASON_COUNT,)), joints=("i8", (REASON_COUNT,)), sent="3f8"),
    **states(reason="i8", trip_tick="i8", trip_value="f8", trip_joint="i8"),
    retraction=RETRACTION_RECORD,
)


@njit(cache=True, error_model="numpy")
def observe(m, count_m, count_l, ticks, tick):
    """Process a new encoder message in the monitor, `ticks` of `tick` (s) after the previous one."""
    dt = ticks * tick
    share = low_pass_share(m.limits.filter, dt)
    observe_joints(m.belief, m.seen, share, dt, count_m, count_l, m.sent)
    posed = observe_platform(m.belief, m.seen, share, dt)
    m.values[Reason.NO_POSE] = 0.0 if posed else 1.0
    observe_contact(m.seen, m.limits.contact_force, ticks)
    if posed and m.limits.drive_droop > 0.0:
        update_hidden_force(m.limits, m.belief, m.seen, ticks, dt)
    update_timers(m.limits, m.seen, m.timers, m.sent, ticks)
    evaluate_sample(m.seen, m.timers, m.values, m.joints, tick)
    # without a pose that fits the encoders, the retraction has no start position
    if posed:
        m.seen.started = 1


@njit(cache=True, error_model="numpy")
def receive_sample(m, u, tick):
    """Read the encoder message from the monitor's inputs `u`; return the ticks since the previous message, 0 without a
    new one."""
    # not >=: that would let NaN pass
    lost = 0 if abs(u.sample) < MAX_SAMPLE_NUMBER else 1
    m.values[Reason.INVALID_SAMPLE] = count_unusable(u.count_m, MAX_COUNT) + count_unusable(u.count_l, MAX_COUNT) + lost
    # after a trip the sound encoders of such a message are judged
    if m.values[Reason.INVALID_SAMPLE] > 0.0 and (m.reason == 0 or lost):
        return 0
    sample = int(u.sample)
    if not m.seen.started:
        m.first_tick, m.first_sample, m.sample = m.tick, sample, sample - 1
    m.values[Reason.STALE] = tick * abs((m.tick - m.first_tick) - (sample - m.first_sample) * m.sample_interval)
    if sample <= m.sample:
        return 0
    ticks = (sample - m.sample) * m.sample_interval
    m.sample = sample
    observe(m, u.count_m, u.count_l, ticks, tick)
    return ticks


def monitor_outputs(lines: bool) -> tuple[Port, ...]:
    """Return the output ports of a monitor, with or without a power line per drive."""
    return (*MONITOR_OUTPUTS, *LINE_PORTS) if lines else MONITOR_OUTPUTS


def monitor_inputs(remote: bool) -> tuple[Port, ...]:
    """Return the input ports of a monitor, with or without the age of a remote controller's commands."""
    return (*MONITOR_INPUTS, AGE_PORT) if remote else MONITOR_INPUTS


@cache
def make_step(lines, remote=False):
    """Compile the step function of a monitor, with or without a power line per drive and a remote controller."""

    @step_function(MONITOR_MEMORY, monitor_inputs(remote), monitor_outputs(lines))
    def step(m, t, h, u, y):
        tick = h / m.period
        ticks = receive_sample(m, u, tick)
        evaluate_command(m.limits, m.timers, u.omega_ref, m.values, m.joints, m.period, tick)
        if remote:
            m.values[Reason.SILENT] = u.age
        reason, utilisation = first_violation(m.values, m.limit, m.rest)
        since = (m.tick - m.trip_tick) * tick
        if m.reason == 0 and reason != 0:
            m.reason, m.trip_tick, m.trip_value, m.trip_joint = reason, m.tick, m.values[reason], m.joints[reason]
        elif m.reason != 0 and ticks > 0:
            add_travel(m.limits, m.seen, m.retraction, ticks * tick)
            supervise(m.limits, m.seen, m.retraction, lines, ticks, tick, m.tick, since)
        if m.reason != 0:
            first = m.reason if m.trip_tick == m.tick else 0
            mark_doubtful_encoders(m.limits, m.seen, m.timers, m.retraction, first, u.count_m, u.count_l, ticks, tick)
        since = (m.tick - m.trip_tick) * tick
        if m.reason != 0:
            m.retraction.blind = 0 if ticks > 0 else m.retraction.blind + m.period
            unseen = m.retraction.blind * tick >= REACHED_SHARE * m.limits.stale_time
            if ticks > 0 or unseen:
                enforce(m.limits, m.seen, m.retraction, lines, m.tick, since, m.values[Reason.STALE], unseen)
            close_brakes(m.limits, m.seen, m.retraction, tick, m.tick)
        for i in range(3):
            m.sent[i] = u.omega_ref[i]
            if m.reason != 0:
                turning = retraction_speed(m.limits, m.retraction, since)
                m.sent[i] = 0.0 if m.retraction.off[i] else turning
            y.omega_ref[i] = m.sent[i]
        if m.reason == 0:
            update_command_bounds(m.limits, m.retraction, m.sent, h)
        y.tripped, y.reason, y.power = m.reason != 0, m.reason, m.retraction.power
        y.F_z, y.speed, y.depth = -m.seen.F_ee_B[2], m.seen.speed, m.seen.depth
        y.contact_time, y.utilisation = m.seen.contact_ticks * tick, utilisation
        if lines:
            for i in range(3):
                y.drive_power[i] = 1.0 - m.retraction.off[i]
            y.brake = m.retraction.brake
        m.tick += m.period
        return 0

    return step


class SafetyMonitor(NativeComponent):
    """Safety monitor: a sampled component between controller (or its delay) and drives.

    It latches at the first reached limit, retracts the robot, then holds it; docs/safety.md has the reasons.

    Args:
        sample_interval: ticks between two encoder messages.
        period: period in ticks.
        lines: whether each drive has a power line of its own, and brakes have one.
        silence: age of a remote controller's command (s) that trips; None without such a controller.
    """

    def __init__(
        self,
        belief: MonitorBelief,
        limits: Limits,
        sample_interval: int = 1,
        period: int = 1,
        lines: bool = False,
        silence: float | None = None,
    ):
        memory = memory_of(MONITOR_MEMORY, belief=tuple(belief), limits=tuple(limits), sample_interval=sample_interval)
        memory["limit"][0], memory["rest"][0] = thresholds(limits)
        if silence is not None:
            memory["limit"][0, Reason.SILENT] = silence
        memory["period"], memory["retraction"]["power"], memory["retraction"]["power_off_tick"] = period, 1, -1
        ports = monitor_outputs(lines)
        initial = np.zeros(width(ports))
        for line in ("power", "drive_power")[: 1 + lines]:
            by_port(ports, initial)[line][:] = 1.0
        inputs, step = monitor_inputs(silence is not None), make_step(lines, silence is not None)
        super().__init__("monitor", inputs, ports, True, step, memory, initial, period)

    @property
    def trip(self) -> Trip | None:
        """Latched trip of the monitor; None before a trip."""
        m = self.memory[0]
        reason = Reason(int(m["reason"]))
        if reason is Reason.NONE:
            return None
        return Trip(
            int(m["trip_tick"]), reason, float(m["trip_value"]), float(m["limit"][reason]), int(m["trip_joint"])
        )

    @property
    def power_off_tick(self) -> int | None:
        """Tick of the first loss of power by any drive; None while all drives have power."""
        tick = int(self.memory[0]["retraction"]["power_off_tick"])
        return None if tick < 0 else tick


def own_monitor(system: System) -> SafetyMonitor | None:
    """Find the `SafetyMonitor` of a system; None without a monitor or with a third-party one."""
    return next((c for c in system.components if isinstance(c, SafetyMonitor)), None)


def trip_reason(simulation: Simulation) -> str:
    """Return the trip message of the safety monitor of a simulation; "" without a trip or a monitor."""
    if own := own_monitor(simulation.system):
        return trip_message(own.trip) if own.trip else ""
    if not simulation.system.has_output("monitor.tripped"):
        return ""
    other = simulation.system.component("monitor")
    tripped = by_port(other.outputs, simulation.outputs(other))["tripped"][0] != 0.0
    return other_trip(other) if tripped else ""


def other_trip(monitor: Component) -> str:
    """Return the trip message of a third-party monitor."""
    return f"safety monitor: {monitor.label or monitor.name} has tripped; see its output 'reason'"
