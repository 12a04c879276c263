"""Compensation of the springs: the motors lead a changing force, and yield to swings of the springs' torque.

The motors wind the springs up for a force that is about to change. The spring's torque is tau_l = k_s N eta (theta_m -
N theta_l) (Eq. 20), so for a load F on the environment the motor leads by tau_l/(k_s N eta) with J^T tau_l = F (virtual
work). A friction force that turns with the direction of motion, as on a circle, changes this lead permanently; the
position loop alone would lag by up to omega mu F/(K_xy kp), and the circle would become too large.

The position loop moves the motors in response to the platform. With a drive without lag, x_m' = -kp x, platform mass m,
spring stiffness K and joint friction b, the platform obeys m x'' = f - b x' with f = K (x_m - x): its swing is stable
for kp < b/m only. If the motors yield by g (m/s per N) of the spring's force, x_m' = -kp x - g f, stability extends to
kp < (b/m + g K)(1 + g b), by Routh's criterion on m s^3 + (b + g K m) s^2 + (K + g K b) s + K kp. A high-pass leaves
steady forces unchanged.
"""

import math
from typing import Any

from twin.kernel.compiled.function import njit
from twin.kernel.cosim.port import record_of, states
from twin.kernel.settings import Settings, Values, numbers, setting, setting_fields
from twin.robot.controller.pid import LOW_PASS_RECORD, cached_share
from twin.robot.mechanism.geometry import Model

REST_SPEED = 1e-3
"""Speed (m/s) below which friction fades out, as it has no direction at rest."""


class Damping(Settings):
    """[controller.damping]: yielding of the motors to swings of the springs' torque."""

    gain: float = setting("rad/s/(N m)", ge=0, help="motor speed per torque of the springs, against oscillation")
    corner: float = setting("Hz", gt=0, help="corner of the high-pass of that torque; slower swings are not damped")


DAMPER_RECORD = record_of(Damping, **states(slow="3f8", started="i8", low=LOW_PASS_RECORD))


def damper(damping: Damping, slow: Any = (0.0, 0.0, 0.0), started: bool = False) -> tuple:
    """Return the initial record of the damping, at rest unless the slow torques (3,), N m, are given."""
    return (*numbers(damping).values(), slow, started, (0.0, 0.0, 0.0))


@njit(cache=True)
def damp(damper, torque_per_spring, tau_l, h, lead):
    """Subtract the motors' yielding to swings of the spring torques from the motor speeds `lead` (3,), rad/s.

    `torque_per_spring` is the ratio N eta of the joint torques `tau_l` (3,), N m, to the springs' torques; `h` in s.
    """
    share = cached_share(damper.low, damper.corner, h) if damper.started else 1.0
    damper.started = 1
    for i in range(3):
        tau = tau_l[i] / torque_per_spring
        damper.slow[i] += share * (tau - damper.slow[i])
        lead[i] -= damper.gain * (tau - damper.slow[i])


class FeedForward(Settings):
    """[controller.feed_forward]: believed lag of the drives and friction under the head."""

    lag: float = setting("ms", ge=0, help="believed time constant of the drives")
    friction: float = setting(ge=0, field="mu", help="believed coefficient of friction under the head")


class FeedForwardModel(
    Values, parts=(setting_fields(Model, "k_s", "eta"), setting_fields(FeedForward)), first="k_s eta mu lag"
):
    """Parameters of the controller's feed-forward: believed spring and belt, and the settings of the feed-forward."""


FEED_FORWARD_RECORD = record_of(FeedForwardModel)


@njit(cache=True)
def friction_force(mu, F_n, v_x, v_y):
    """Return the friction (F_x, F_y) in N of the robot on the surface for a velocity (m/s) and a normal force (N)."""
    speed = math.sqrt(v_x * v_x + v_y * v_y + REST_SPEED * REST_SPEED)
    return mu * F_n * v_x / speed, mu * F_n * v_y / speed


@njit(cache=True, error_model="numpy")
def load_torques(J, f_x, f_y, f_z):
    """Return the joint torques tau_l (N m) for a force F on the environment, tau_l = J^-T F."""
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
