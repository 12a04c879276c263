"""PID loops of the robot's computer and of its servos, with settings, filters, damping and feed-forward.

What the robot's computer is besides its loops: period, delays, the largest command, what it knows of the robot.

[controller.position] and [controller.force]: the two loops of Fig. 3 B, and gains over the stiffness.

A state-variable filter of second order: low-pass, band-pass and high-pass of one signal at once.

A discrete PID: rectangular integral that stops at the limit, first-order filter on the derivative.

Damping of the platform on its springs: the motors give way to swings of the springs' torque. The position loop moves
the motors by what the platform does. With a drive without lag, x_m' = -kp x, platform mass m, spring stiffness K and
joint friction b, m x'' = f - b x' with f = K (x_m - x), that drives the swing of the platform: it is stable for kp <
b/m only. If the motors give way by g (m/s per N) of the spring's force, x_m' = -kp x - g f, it is so for kp < (b/m + g
K)(1 + g b), by Routh's criterion on m s^3 + (b + g K m) s^2 + (K + g K b) s + K kp. A high-pass leaves steady forces
alone.

Our velocity loop for drives that take torque, current or voltage: a discrete PI at its own rate.

What the motors have to do besides moving the platform: wind the springs up for a force that is about to change. The
spring's torque is tau_l = k_s N eta (theta_m - N theta_l) (Eq. 20), so for a load F on the environment the motor leads
by tau_l/(k_s N eta) with J^T tau_l = F (virtual work). A friction force that turns with the direction of motion, as on
a circle, makes this lead change all the time; the position loop alone would lag behind by up to omega mu F/(K_xy kp),
and the circle would come out too large.

Commanded speed into commanded angle, for drives that close a position loop of their own.
"""

import math
from collections.abc import Sequence
from itertools import pairwise
from typing import Any, Literal, NamedTuple

from pydantic import model_validator

from twin.kernel.compiled.function import njit
from twin.kernel.cosim.component import NativeComponent, step_function
from twin.kernel.cosim.port import Port, memory_of, record, record_of, state, states
from twin.kernel.settings import Settings, Values, numbers, optional, setting, taken
from twin.robot.mechanism.geometry import Model


class Processor(Settings):
    """The keys of [controller] itself."""

    mode: Literal["force_position", "position"] = setting(help="force and position, or position alone")
    period: float = setting("ms", gt=0, help="time between two commands")
    delay_ticks: int = setting(default=0, ge=0, le=1000, help="computation delay")
    bus_delay_ticks: int = setting(default=0, ge=0, le=1000, help="delay of the bus to the drives, behind the monitor")
    speed_limit: float = setting("rad/s", gt=0, field="omega_max", help="largest motor speed it commands")
    gravity_compensation: bool = setting(help="take the robot's own weight out of the estimated force")
    dead_zone: float = setting(
        "deg",
        default=0.0,
        ge=0,
        field="backlash",
        help="believed half width of the backlash, which the estimator takes off; 0: the paper's estimator",
    )


@njit(cache=True)
def state_variable(damping, g, fast, slow, x):
    """(low-passed `x`, its derivative over 2 pi f, its second over (2 pi f)^2, the two states after it).

    By the trapezoidal rule, so the derivatives are those of the output itself (Zavalishin 2012, The Art of VA Filter
    Design, Ch. 4).

    Args:
        damping: 1/Q.
        g: tan(pi f h), of the corner f (Hz) and the period h (s).
        fast, slow: states after the call before; at rest 0 and the signal.
    """
    # a factor, which does not wait for x and is one for all stages of a filter
    high = (x - (damping + g) * fast - slow) * (1.0 / (1.0 + g * (damping + g)))
    band = g * high + fast
    low = g * band + slow
    return low, band, high, band + g * high, low + g * band


WIDEST_GAP = 3.0
"""Largest ratio of stiffness of two neighbours in a schedule."""


class ScheduledGains(Settings):
    """[[controller.force.schedule]]: gains of the force loop on a tissue of one stiffness."""

    stiffness: float = setting("N/m", gt=0, le=20_000, examples=[300.0], help="of the tissue")
    kp: float = setting("mm/N", gt=0, le=1000, examples=[2.0], help="shift of the z reference per force error")
    ki: float = setting("mm/(N s)", gt=0, le=10_000, examples=[40.0], help="integral gain")


def order_refused(points: Sequence[ScheduledGains]) -> str:
    """Why `points` are no schedule; "" if they are one, or none."""
    if len(points) == 1:
        return "one point; expected two or more, for one is kp_mm_per_N and ki_mm_per_N_s"
    for number, (below, above) in enumerate(pairwise(points), start=2):
        if above.stiffness <= below.stiffness:
            order = f"point {number} is at {above.stiffness:g} N/m, after {below.stiffness:g}"
            return f"{order}; expected the softest first"
        if above.stiffness > WIDEST_GAP * below.stiffness:
            gap = f"a gap from {below.stiffness:g} to {above.stiffness:g} N/m, in which no set of gains holds"
            return f"{gap}; expected points at most {WIDEST_GAP:g}-fold apart"
    return ""


class PositionLoop(Settings):
    """[controller.position]: PID from position error (m) to platform speed (m/s), the same on x, y and z."""

    kp: float = setting("1/s", ge=0, le=1000, tunable=True, help="platform speed per position error")
    ki: float = setting("1/s2", default=0.0, ge=0, help="integral gain")
    kd: float = setting(default=0.0, ge=0, help="derivative gain")
    derivative_filter: float = setting(
        "Hz", field="derivative_corner", default=0.0, ge=0, help="low-pass of the derivative; 0: none"
    )


class ForceLoop(Settings):
    """[controller.force]: PID from force error (N) to a shift of the z reference (m), and what starts it."""

    reference: float | None = optional(
        "N", gt=0, le=50, example=5.0, field="F_z_ref", absent=0.0, tunable=True, help="pressing force to hold"
    )
    trigger: float | None = optional(
        "N", ge=0, example=0.6, field="trigger_force", absent=math.inf, help="pressing force that starts the force loop"
    )
    trigger_time: float | None = optional(
        "s", ge=0, example=6.0, absent=math.inf, help="when the force loop starts, whatever the force"
    )
    kp: float = setting(
        "mm/N", ge=0, le=1000, into="gains", tunable=True, help="shift of the z reference per force error"
    )
    ki: float = setting("mm/(N s)", ge=0, le=10_000, into="gains", tunable=True, help="integral gain")
    kd: float = setting("mm s/N", default=0.0, ge=0, into="gains", help="derivative gain")
    derivative_filter: float = setting(
        "Hz", default=0.0, ge=0, into="gains", field="derivative_corner", help="low-pass of the derivative; 0: none"
    )
    limit: float = setting("mm", gt=0, field="dp_z_max", help="largest shift of the z reference")
    filter: float = setting("Hz", ge=0, field="corner", help="low-pass of the estimated force; 0: none")
    schedule: tuple[ScheduledGains, ...] = setting(
        default=(),
        examples=[[
            {"stiffness_N_per_m": 600.0, "kp_mm_per_N": 2.0, "ki_mm_per_N_s": 30.0},
            {"stiffness_N_per_m": 1200.0, "kp_mm_per_N": 1.5, "ki_mm_per_N_s": 15.0},
        ]],
        help="gains over the stiffness that [controller.tissue] estimates, softest first; without it, these",
    )  # fmt: skip
    follow: float = setting(
        into="schedule",
        default=1.0,
        ge=0,
        le=1,
        help="with a schedule: share of a change of the reference that is fed forward",
    )
    rate: float = setting(
        "1/s", into="schedule", default=2.0, gt=0, le=100, help="with a schedule: largest relative change of the gains"
    )

    @model_validator(mode="after")
    def _softest_first(self) -> "ForceLoop":
        if refusal := order_refused(self.schedule):
            raise ValueError(f"schedule: {refusal}")
        return self


class Gains(Values, parts=(taken(PositionLoop),)):
    """Gains of one loop, SI: kp, ki, kd, and the corner of the derivative filter (0: unfiltered)."""


def force_gains(table: ForceLoop) -> Gains:
    """Those of the force loop."""
    return Gains(**numbers(table, into="gains"))


PID = record_of(Gains, **states(integral="f8", derivative="f8", error="f8", started="i8"))
LOW_PASS = record(corner="f8", h="f8", share="f8")
"""The share of a low-pass that was worked out last, and for what: an exponential costs as much as a loop."""


def loop(gains: Gains) -> tuple:
    """A record of dtype `PID` at rest."""
    return (*gains, 0.0, 0.0, 0.0, 0)


@njit(cache=True)
def low_pass_share(corner, h):
    """How much of a new sample a first-order low-pass with `corner` (Hz) takes over per period `h` (s)."""
    return 1.0 - math.exp(-2.0 * math.pi * corner * h) if corner > 0.0 else 1.0


@njit(cache=True)
def cached_share(cache, corner, h):
    """`low_pass_share`, worked out where corner or period are not those of the call before.

    Args:
        cache: a record of `LOW_PASS`; at first 0.
    """
    if cache.corner != corner or cache.h != h:
        cache.corner, cache.h, cache.share = corner, h, low_pass_share(corner, h)
    return cache.share


@njit(cache=True)
def proposal(pid, e, h):
    """(output, integral): what the loop would do for error `e`; `accept` keeps the integral.

    The derivative acts on the error and starts at 0. A caller that limits the output accepts the integral only if it
    was within its limit: conditional integration, so nothing winds up.
    """
    if pid.started and pid.kd != 0.0:
        rate = (e - pid.error) / h
        pid.derivative += low_pass_share(pid.derivative_corner, h) * (rate - pid.derivative)
    pid.error = e
    pid.started = 1
    integral = pid.integral + pid.ki * e * h
    return pid.kp * e + integral + pid.kd * pid.derivative, integral


@njit(cache=True)
def accept(pid, integral):
    """Keep the proposed integral."""
    pid.integral = integral


@njit(cache=True)
def rest(pid):
    """Forget every error so far."""
    pid.integral, pid.derivative, pid.error, pid.started = 0.0, 0.0, 0.0, 0


class Damping(Settings):
    """[controller.damping]: how the motors give way to swings of the springs' torque."""

    gain: float = setting("rad/s/(N m)", ge=0, help="motor speed per torque of the spring")
    corner: float = setting("Hz", gt=0, help="swings slower than this are not damped")


DAMPER = record_of(Damping, **states(slow="3f8", started="i8", low=LOW_PASS))


def damper(damping: Damping, slow: Any = (0.0, 0.0, 0.0), started: bool = False) -> tuple:
    """A record of dtype `DAMPER` that has felt nothing yet, unless its state is given: slow torques (3,), N m."""
    return (*numbers(damping).values(), slow, started, (0.0, 0.0, 0.0))


@njit(cache=True)
def damp(damper, torque_per_spring, tau_l, h, lead):
    """Take from the motor speeds `lead` (3,), rad/s, what the motors give way.

    Args:
        torque_per_spring: N eta, by which the joint torques `tau_l` (3,) N m exceed the springs'.
        h: time since the last call (s).
    """
    share = cached_share(damper.low, damper.corner, h) if damper.started else 1.0
    damper.started = 1
    for i in range(3):
        tau = tau_l[i] / torque_per_spring
        damper.slow[i] += share * (tau - damper.slow[i])
        lead[i] -= damper.gain * (tau - damper.slow[i])


INPUTS = (
    Port("omega_ref", 1, "rad/s", "commanded motor speed"),
    Port("omega_m", 1, "rad/s", "motor speed, as the drive reports it"),
)
COMMAND = Port("command", 1, "SI", "what the drive takes: torque, current or voltage")
MEMORY = record(pid=PID, limit="f8")


@step_function(MEMORY, INPUTS, (COMMAND,))
def step(m, t, h, u, y):
    command, integral = proposal(m.pid, u.omega_ref - u.omega_m, h)
    if abs(command) <= m.limit:
        accept(m.pid, integral)
    y.command = min(max(command, -m.limit), m.limit)
    return 0


class DriveSpeedLoop(NativeComponent):
    """Sampled component: speed error in, command of the drive out.

    Args:
        gains: PI from rad/s to the command's SI unit.
        limit: of the command, either side.
        command: port of the output.
        period: in ticks of the drive's own system.
    """

    def __init__(self, gains: Gains, limit: float, command: Port, period: int = 1):
        memory = memory_of(MEMORY, pid=loop(gains), limit=limit)
        super().__init__("velocity_loop", INPUTS, (command,), True, step, memory, period=period)


REST_SPEED = 1e-3
"""Speed (m/s) below which the friction fades out, for it has no direction at rest."""


class FeedForward(Settings):
    """[controller.feed_forward]: what the controller believes of the drives' lag and the friction under the head."""

    lag: float = setting("ms", ge=0, help="believed lag of the drives")
    friction: float = setting(ge=0, field="mu", help="believed friction under the head")


class Believed(Values, parts=(taken(Model, "k_s", "eta"), taken(FeedForward)), first="k_s eta mu lag"):
    """What the feed-forward believes: spring and belt of the model, and its own settings."""


FEED_FORWARD = record_of(Believed)


@njit(cache=True)
def friction_force(mu, F_n, v_x, v_y):
    """(F_x, F_y): friction by the robot on the surface (N) when sliding at (v_x, v_y) m/s with normal force F_n (N)."""
    speed = math.sqrt(v_x * v_x + v_y * v_y + REST_SPEED * REST_SPEED)
    return mu * F_n * v_x / speed, mu * F_n * v_y / speed


@njit(cache=True, error_model="numpy")
def load_torques(J, f_x, f_y, f_z):
    """Torques tau_l (N m) of the three joints with J^T tau_l = F, J (9,) row by row."""
    a, b, c, d, e, f, g, h, i = J[0], J[1], J[2], J[3], J[4], J[5], J[6], J[7], J[8]
    # rows of the inverse of J^T are the cross products of J's rows
    x_1, y_1, z_1 = e * i - f * h, f * g - d * i, d * h - e * g
    x_2, y_2, z_2 = h * c - i * b, i * a - g * c, g * b - h * a
    x_3, y_3, z_3 = b * f - c * e, c * d - a * f, a * e - b * d
    det = a * x_1 + b * y_1 + c * z_1
    return (
        (x_1 * f_x + y_1 * f_y + z_1 * f_z) / det,
        (x_2 * f_x + y_2 * f_y + z_2 * f_z) / det,
        (x_3 * f_x + y_3 * f_y + z_3 * f_z) / det,
    )


POSITION_INPUTS = (
    Port("omega_ref", 1, "rad/s", "commanded motor speed"),
    Port("theta_m", 1, "rad", "motor angle, as the drive reports it"),
)
POSITION_OUTPUTS = (
    Port("command", 1, "rad", "commanded motor angle"),
    Port("goal", 1, "rad", "the same angle from the zero of the servo, within its turn"),
)


class Servo(NamedTuple):
    """How a servo counts its angle phi, and which commands it takes: phi = ratio (theta_m - zero).

    Attributes:
        zero: motor angle at phi = 0 (rad).
        ratio: turns of its shaft per turn of the motor shaft, negative if it turns the other way.
        lower, upper: limits of phi (rad).
        wrap: phi is counted from here over one turn (rad); infinite: it counts on.
        lead: most by which the commanded motor angle is ahead of the motor, either way (rad).
    """

    zero: float
    ratio: float
    lower: float = -math.inf
    upper: float = math.inf
    wrap: float = math.inf
    lead: float = math.inf


POSITION_MEMORY = record_of(Servo, command=state("f8"))


@step_function(POSITION_MEMORY, POSITION_INPUTS, POSITION_OUTPUTS)
def position_step(m, t, h, u, y):
    # where it has to be when the next command comes
    command = m.command + u.omega_ref * h
    command = min(max(command, u.theta_m - m.lead), u.theta_m + m.lead)
    phi = min(max(m.ratio * (command - m.zero), m.lower), m.upper)
    m.command = m.zero + phi / m.ratio
    if m.wrap < math.inf:
        phi = m.wrap + (phi - m.wrap) % math.tau
    y.command = m.command
    y.goal = phi / m.ratio
    return 0


class DriveSpeedIntegrator(NativeComponent):
    """Sampled component: speed in, angle of the drive out. What limit and lead take away is not made up for later.

    Args:
        servo: what stands behind it.
        theta_m: motor angle at t = 0 (rad), where the command begins.
        period: in ticks of the drive's own system.
    """

    def __init__(self, servo: Servo, theta_m: float, period: int = 1):
        memory = memory_of(POSITION_MEMORY, **servo._asdict(), command=theta_m)
        super().__init__(
            "position_command", POSITION_INPUTS, POSITION_OUTPUTS, True, position_step, memory, period=period
        )
