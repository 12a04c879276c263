"""Damping of the platform on its springs: the motors give way to swings of the springs' torque.

The position loop moves the motors by what the platform does. With a drive without lag, x_m' = -kp x, platform mass m,
spring stiffness K and joint friction b, m x'' = f - b x' with f = K (x_m - x), that drives the swing of the platform:
it is stable for kp < b/m only. If the motors give way by g (m/s per N) of the spring's force, x_m' = -kp x - g f, it
is so for kp < (b/m + g K)(1 + g b), by Routh's criterion on m s^3 + (b + g K m) s^2 + (K + g K b) s + K kp. A
high-pass leaves steady forces alone.
"""

from typing import Any

from twin.compiled.function import njit
from twin.controller.pid import LOW_PASS, kept_share
from twin.cosim.record import record_of
from twin.settings import Settings, numbers, setting


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
