"""What the motors have to do besides moving the platform: wind the springs up for a force that is about to change.

The spring's torque is tau_l = k_s N eta (theta_m - N theta_l) (Eq. 20), so for a load F on the environment the motor
leads by tau_l/(k_s N eta) with J^T tau_l = F (virtual work). A friction force that turns with the direction of motion,
as on a circle, makes this lead change all the time; the position loop alone would lag behind by up to
omega mu F/(K_xy kp), and the circle would come out too large.
"""

import math

from twin.compiled.function import njit
from twin.cosim.record import record_of
from twin.robot.model import Model
from twin.settings import Settings, Values, setting, taken

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
