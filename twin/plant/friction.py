"""Dry friction of joints and within springs, and their hard stops: forces that know where, and no speed.

Dry friction is a spring that slides (Prandtl 1928, Z angew Math Mech 8:85): it holds at an anchor, yields elastically,
and drags the anchor along once it carries all that it can:

    joint    tau_f = (tau_c/a) (theta_l - theta_0),  within +-tau_c            (P14)
    spring   w = d + (d - d_0),  the bracket within +-h |d|                    (P15)

a is the angle over which a joint yields before it breaks loose. A spring with the hysteresis h carries k_s w: (1 + h)
k_s d while it is wound up, (1 - h) k_s d while it unwinds, and nothing in its backlash. Within a step the anchors stand
still, so both are forces with a potential; after it they are dragged along, which only lowers what is stored. So
friction sticks truly, takes energy, and never makes any.

A hard stop is an elastic one, of stiffness k_e: beyond a deflection d_e a spring has k_s + k_e, and a joint is pushed
back into its range by k_e times what it is out of it.
"""

import math

from twin.compiled.function import njit

HELD, GRIPPED = 3, 4
"""Columns of the anchors of `robot.leg` in which a plant keeps theta_0 and d_0 (rad)."""
ANCHORS = 5


@njit(cache=True, forceinline=True)
def _within(value, limit):
    """`value`, no larger than `limit` either way; 0 for what is held nowhere yet."""
    if value > limit:
        return limit
    if value < -limit:
        return -limit
    return value if value == value else 0.0


# numpy's division here and below: an exception of compiled code that the master calls by address is lost
@njit(cache=True, error_model="numpy", forceinline=True)
def friction_torque(parameters, anchors, leg, theta_l):
    """Torque (N m) with which the dry friction of a joint holds it, (P14)."""
    away = theta_l - anchors[leg, HELD]
    return _within(parameters.joint_friction / parameters.joint_presliding * away, parameters.joint_friction)


@njit(cache=True, forceinline=True)
def gripped(parameters, anchors, leg, d):
    """The deflection (rad) of a spring without hysteresis that carries what this one does at `d`, (P15)."""
    return d + _within(d - anchors[leg, GRIPPED], parameters.spring_hysteresis * abs(d))


@njit(cache=True, forceinline=True)
def drag(parameters, anchors, leg, theta_l, d):
    """Move the anchors of `leg`, in place, to where the joint at `theta_l` and its spring at `d` (rad) drag them."""
    anchors[leg, HELD] = theta_l - _within(theta_l - anchors[leg, HELD], parameters.joint_presliding)
    anchors[leg, GRIPPED] = d - _within(d - anchors[leg, GRIPPED], parameters.spring_hysteresis * abs(d))


@njit(cache=True, error_model="numpy", forceinline=True)
def stopped(parameters, d):
    """The deflection (rad) of a spring without a stop that carries what this one does at `d`."""
    over = abs(d) - parameters.spring_stop
    return d + math.copysign(parameters.stop / parameters.k_s * over, d) if over > 0.0 else d


@njit(cache=True, error_model="numpy")
def unstopped(parameters, d):
    """The deflection (rad) at which a spring with a stop carries what one without does at `d`: `stopped` inverted."""
    over = abs(d) - parameters.spring_stop
    return d - math.copysign(over - over / (1.0 + parameters.stop / parameters.k_s), d) if over > 0.0 else d


@njit(cache=True, forceinline=True)
def stop_torque(parameters, theta_l):
    """Torque (N m) with which its hard stops push a joint back into its range; 0 within."""
    if theta_l > parameters.joint_upper:
        return parameters.stop * (parameters.joint_upper - theta_l)
    if theta_l < parameters.joint_lower:
        return parameters.stop * (parameters.joint_lower - theta_l)
    return 0.0
