"""The safety monitor as a co-simulation component between controller and drives, and its safe action.

That is to raise the platform away from the person, then hold it; cut the power if the motors do not obey.

All motors turn at the same speed -retract_speed for a set time. Positive theta lowers the platform (Eq. 5), so this
raises it: the height changes by the sum of the third row of J^-1 times the joints' speed, and that sum is positive
everywhere in the workspace (docs/safety.md has the numbers). No encoder takes part, because a wrong encoder may be the
reason for the trip.
"""

from typing import NamedTuple

import numpy as np
from numpy.typing import ArrayLike

from twin.kernel.compiled.function import njit
from twin.kernel.cosim.component import Component, NativeComponent, step_function
from twin.kernel.cosim.port import Port, by_port, memory_of, record, state, states, width
from twin.kernel.cosim.simulation import Simulation
from twin.kernel.cosim.system import System
from twin.robot.mechanism.geometry import Geometry
from twin.robot.mechanism.kinematics import joint_angles, position
from twin.robot.monitor.checks import (
    INVALID_SAMPLE,
    LARGEST_COUNT,
    LARGEST_SAMPLE,
    LIMITS,
    NO_POSE,
    REASONS,
    STALE,
    TIMERS,
    Limits,
    Reason,
    Trip,
    first_reached,
    thresholds,
    time_joints,
    trip_sentence,
    unusable,
    value_command,
    value_sample,
)
from twin.robot.monitor.observation import (
    BELIEF,
    SEEN,
    MonitorBelief,
    low_pass_share,
    observe_contact,
    observe_joints,
    observe_platform,
)

STEPS = 101

RETRACTION = record(**states(unfollowed="3i8", power="i8", power_off_tick="i8"))
"""Ticks for which each joint has not followed the retraction; power; the tick at which it went off, -1: never."""


@njit(cache=True)
def retraction_speed(limits, retraction, since):
    """Speed (rad/s) of every motor, `since` (s) the trip."""
    turning = retraction.power == 1 and since < (limits.retract - 1e-9) / limits.retract_speed
    return -limits.retract_speed if turning else 0.0


@njit(cache=True)
def supervise(limits, seen, retraction, ticks, tick, now):
    """Take the power if a joint does not do what the retraction commands for `follow_time`.

    Only a joint whose motor and joint encoder both deny it is at fault: a motor that turns moves its joint, so one of
    the two encoders may be the failure.

    Args:
        ticks: since the last valid encoder message, without which no limit is judged.
        tick: in s.
        now: in ticks.
    """
    for i in range(3):
        error_m = abs(seen.omega_cmd[i] - seen.omega_m[i])
        error_l = abs(seen.omega_cmd[i] - seen.omega_l[i])
        astray = min(error_m, error_l) >= limits.follow_limit
        retraction.unfollowed[i] = retraction.unfollowed[i] + ticks if astray else 0
        if retraction.unfollowed[i] * tick >= limits.follow_time * (1.0 - 1e-9) and retraction.power == 1:
            retraction.power = 0
            retraction.power_off_tick = now


class Retreat(NamedTuple):
    """What a retraction does to the platform.

    Attributes:
        raised: how much higher it ends (m).
        sideways: how far it moves horizontally (m).
        slowest: lowest rise per motor angle on the way (m/rad); negative where it would sink.
    """

    raised: float
    sideways: float
    slowest: float


def retreat(geometry: Geometry, N: float, p_B: ArrayLike, retract: float) -> Retreat:
    """Where a retraction by `retract` (rad, each motor) takes a robot in free air that stands at `p_B` (3,), m.

    Forward kinematics (Eq. 13-17) along the path on which theta_l = theta_m / N falls equally on all legs. A robot that
    presses rises less, by what its springs unwind: the force over their stiffness J^T k_s N^2 eta J.

    Raises:
        Unreachable: the path leaves the workspace.
        InputRefused: p_B is not finite or not of shape (3,).
    """
    theta_m = np.linspace(0.0, retract, STEPS)
    path = position(geometry, joint_angles(geometry, p_B) - theta_m[:, None] / N)
    raised, sideways = path[-1, 2] - path[0, 2], np.hypot(*(path[-1, :2] - path[0, :2]))
    return Retreat(float(raised), float(sideways), float(np.min(np.diff(path[:, 2]) / np.diff(theta_m))))


INPUTS = (
    Port("count_m", 3, "1", "motor encoder counts"),
    Port("count_l", 3, "1", "joint encoder counts"),
    Port("sample", 1, "1", "number of the encoder message, one more with each"),
    Port("omega_ref", 3, "rad/s", "motor speeds that the controller commands"),
)
POWER = Port("power", 1, "1", "whether the drives may have power", "bool")
OUTPUTS = (
    Port("omega_ref", 3, "rad/s", "motor speeds for the drives: the controller's, after a trip the retraction's"),
    Port("tripped", 1, "1", "whether the monitor has tripped; stays", "bool"),
    Port("reason", 1, "1", "why, a code of docs/safety.md; 0: not tripped", "int"),
    POWER,
    Port("F_z", 1, "N", "pressing force by the monitor's own estimate, low-passed"),
    Port("speed", 1, "m/s", "speed of the platform, low-passed"),
    Port("depth", 1, "m", "how far the platform is below the place where the present contact began"),
    Port("contact_time", 1, "s", "duration of the present contact"),
    Port("utilisation", 1, "1", "largest share of any limit in use; 1 trips"),
)
MEMORY = record(
    belief=BELIEF,
    limits=LIMITS,
    limit=("f8", (REASONS,)),
    rest=("f8", (REASONS,)),
    period="i8",
    sample_interval="i8",
    tick=state("i8"),
    first_tick=state("i8"),
    first_sample=state("i8"),
    sample=state("i8"),
    seen=SEEN,
    timers=TIMERS,
    values=state(("f8", (REASONS,))),
    joints=state(("i8", (REASONS,))),
    sent=state("3f8"),
    reason=state("i8"),
    trip_tick=state("i8"),
    trip_value=state("f8"),
    trip_joint=state("i8"),
    retraction=RETRACTION,
)


@njit(cache=True, error_model="numpy")
def observe(m, count_m, count_l, ticks, tick):
    """Take in a new encoder message, `ticks` of `tick` (s) after the one before."""
    dt = ticks * tick
    share = low_pass_share(m.limits.filter, dt)
    observe_joints(m.belief, m.seen, share, dt, count_m, count_l, m.sent)
    posed = observe_platform(m.belief, m.seen, share, dt)
    m.values[NO_POSE] = 0.0 if posed else 1.0
    observe_contact(m.seen, m.limits.contact_force, ticks)
    time_joints(m.limits, m.seen, m.timers, m.sent, ticks)
    value_sample(m.seen, m.timers, m.values, m.joints, tick)
    # a robot that cannot stand where its encoders say has no position to start from
    if posed:
        m.seen.started = 1


@njit(cache=True, error_model="numpy")
def receive(m, u, tick):
    """Look at the encoder message in the inputs `u`; the ticks since the one before, 0 if it is not a new one."""
    # not >=: that would let NaN pass
    lost = 0 if abs(u.sample) < LARGEST_SAMPLE else 1
    m.values[INVALID_SAMPLE] = unusable(u.count_m, LARGEST_COUNT) + unusable(u.count_l, LARGEST_COUNT) + lost
    if m.values[INVALID_SAMPLE] > 0.0:
        return 0
    sample = int(u.sample)
    if not m.seen.started:
        m.first_tick, m.first_sample, m.sample = m.tick, sample, sample - 1
    m.values[STALE] = tick * abs((m.tick - m.first_tick) - (sample - m.first_sample) * m.sample_interval)
    if sample <= m.sample:
        return 0
    ticks = (sample - m.sample) * m.sample_interval
    m.sample = sample
    observe(m, u.count_m, u.count_l, ticks, tick)
    return ticks


@step_function(MEMORY, INPUTS, OUTPUTS)
def step(m, t, h, u, y):
    tick = h / m.period
    ticks = receive(m, u, tick)
    value_command(m.limits, m.timers, u.omega_ref, m.values, m.joints, m.period, tick)
    reason, utilisation = first_reached(m.values, m.limit, m.rest)
    if m.reason == 0 and reason != 0:
        m.reason, m.trip_tick, m.trip_value, m.trip_joint = reason, m.tick, m.values[reason], m.joints[reason]
    elif m.reason != 0 and ticks > 0:
        supervise(m.limits, m.seen, m.retraction, ticks, tick, m.tick)
    for i in range(3):
        m.sent[i] = u.omega_ref[i]
        if m.reason != 0:
            m.sent[i] = retraction_speed(m.limits, m.retraction, (m.tick - m.trip_tick) * tick)
        y.omega_ref[i] = m.sent[i]
    y.tripped, y.reason, y.power = m.reason != 0, m.reason, m.retraction.power
    y.F_z, y.speed, y.depth = -m.seen.F_ee_B[2], m.seen.speed, m.seen.depth
    y.contact_time, y.utilisation = m.seen.contact_ticks * tick, utilisation
    m.tick += m.period
    return 0


class SafetyMonitor(NativeComponent):
    """Sampled component between controller (or its delay) and drives.

    Latched at the first limit that is reached: it retracts, then holds, see above; docs/safety.md argues why.

    Args:
        belief: the monitor's own model of the robot.
        limits: what it tolerates.
        sample_interval: ticks between two encoder messages.
        period: in ticks.
    """

    def __init__(self, belief: MonitorBelief, limits: Limits, sample_interval: int = 1, period: int = 1):
        memory = memory_of(MEMORY, belief=tuple(belief), limits=tuple(limits), sample_interval=sample_interval)
        memory["limit"][0], memory["rest"][0] = thresholds(limits)
        memory["period"], memory["retraction"]["power"], memory["retraction"]["power_off_tick"] = period, 1, -1
        initial = np.zeros(width(OUTPUTS))
        by_port(OUTPUTS, initial)["power"][0] = 1.0
        super().__init__("monitor", INPUTS, OUTPUTS, True, step, memory, initial, period)

    @property
    def trip(self) -> Trip | None:
        """The latched trip; None while there is none."""
        m = self.memory[0]
        reason = Reason(int(m["reason"]))
        if reason is Reason.NONE:
            return None
        return Trip(
            int(m["trip_tick"]), reason, float(m["trip_value"]), float(m["limit"][reason]), int(m["trip_joint"])
        )

    @property
    def power_off_tick(self) -> int | None:
        """The tick at which the drives lost their power because they did not retract; None while they have it."""
        tick = int(self.memory[0]["retraction"]["power_off_tick"])
        return None if tick < 0 else tick


def own_monitor(system: System) -> SafetyMonitor | None:
    """The `SafetyMonitor` of `system`; None if it has none, or a third-party one."""
    return next((c for c in system.components if isinstance(c, SafetyMonitor)), None)


def trip_reason(simulation: Simulation) -> str:
    """Why the safety monitor of a simulation tripped; "" if it did not, or there is none."""
    if own := own_monitor(simulation.system):
        return trip_sentence(own.trip) if own.trip else ""
    if not simulation.system.has("monitor.tripped"):
        return ""
    other = simulation.system.component("monitor")
    tripped = by_port(other.outputs, simulation.outputs(other))["tripped"][0] != 0.0
    return other_trip(other) if tripped else ""


def other_trip(monitor: Component) -> str:
    """What is known of a trip of a third-party monitor."""
    return f"safety monitor: {monitor.label or monitor.name} has tripped; why, its output 'reason' may say"
