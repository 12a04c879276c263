"""A discrete PID: rectangular integral that stops at the limit, first-order filter on the derivative.

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
"""

import math
from typing import Any

from twin.compiled.function import njit
from twin.controller.loops import ForceLoop, PositionLoop
from twin.cosim.component import NativeComponent
from twin.cosim.native import step_function
from twin.cosim.port import Port, memory_of, record, record_of
from twin.robot.model import Model
from twin.settings import Settings, Values, numbers, setting, taken


class Gains(Values, parts=(taken(PositionLoop),)):
    """Gains of one loop, SI: kp, ki, kd, and the corner of the derivative filter (0: unfiltered)."""


def force_gains(table: ForceLoop) -> Gains:
    """Those of the force loop."""
    return Gains(**numbers(table, into="gains"))


PID = record_of(Gains, integral="f8", derivative="f8", error="f8", started="i8")
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
def kept_share(kept, corner, h):
    """`low_pass_share`, worked out where corner or period are not those of the call before.

    Args:
        kept: a record of `LOW_PASS`; at first 0.
    """
    if kept.corner != corner or kept.h != h:
        kept.corner, kept.h, kept.share = corner, h, low_pass_share(corner, h)
    return kept.share


@njit(cache=True)
def proposal(pid, e, h):
    """(output, integral): what the loop would do for error `e`; `accept` keeps the integral.

    The derivative acts on the error and starts at 0. Whoever limits the output accepts the integral only if the output
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


DAMPER = record_of(Damping, slow="3f8", started="i8", low=LOW_PASS)


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
    share = kept_share(damper.low, damper.corner, h) if damper.started else 1.0
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
