"""Forces on joints and springs: weight in a tilted mounting, dry friction, hard stops.

The base may be tilted about two axes, R = R_y(tilt) R_x(tilt_x) as for a surface. The upward direction is then R^T e_z,
and all weights act against it. The robot's computer ignores the tilt: it compensates a weight along z of B.

Dry friction of joints and within springs depends on position, not on speed. It is a sliding spring (Prandtl 1928, Z
angew Math Mech 8:85): it sticks to an anchor, yields elastically, and drags the anchor along at its maximum force:

    joint    tau_f = (tau_c/a) (theta_l - theta_0),  within +-tau_c            (P14)
    spring   w = d + (d - d_0),  the bracket within +-h |d|                    (P15)

a is the angle over which a joint yields before it slides. A spring with the hysteresis h carries k_s w: (1 + h) k_s d
while its deflection grows, (1 - h) k_s d while it shrinks, and nothing in its backlash. The anchors are fixed within a
step, so both are forces with a potential; dragging them afterwards only lowers the stored energy. So friction truly
sticks, dissipates energy, and never creates any.

A hard stop is elastic with the stiffness k_e: beyond a deflection d_e a spring has k_s + k_e, and a joint out of its
range is pushed back by k_e times the excess.
"""

import math

import numpy as np

from twin.kernel.compiled.function import njit
from twin.robot.mechanism.geometry import LEG_COS, LEG_SIN
from twin.robot.mechanism.statics import arm_weight
from twin.robot.plant.contact import JOINT_ANCHOR, SPRING_ANCHOR

ANCHOR_SIZE = 5


@njit(cache=True, forceinline=True)
def upward(parameters):
    """Return the unit vector against gravity in the frame B of a tilted base, a triple."""
    if parameters.mounting_tilt == 0.0 and parameters.mounting_tilt_x == 0.0:
        return 0.0, 0.0, 1.0
    sin_t, cos_t = math.sin(parameters.mounting_tilt), math.cos(parameters.mounting_tilt)
    sin_x, cos_x = math.sin(parameters.mounting_tilt_x), math.cos(parameters.mounting_tilt_x)
    return -sin_t, cos_t * sin_x, cos_t * cos_x


@njit(cache=True, forceinline=True)
def gravity_lever(up, leg, k_r, k_z):
    """Return the lever (m) of a weight at a leg's knee about the joint: torque = weight * lever."""
    return up[2] * k_r - (LEG_COS[leg] * up[0] + LEG_SIN[leg] * up[1]) * k_z


@njit(cache=True)
def arm_torque(parameters, up, leg, theta_l):
    """Return the torque (N m) of an arm's weight on its joint at the angle `theta_l` (rad)."""
    return arm_weight(parameters) * parameters.l_a * gravity_lever(up, leg, np.cos(theta_l), -np.sin(theta_l))


@njit(cache=True, forceinline=True)
def _clamp(value, limit):
    """Limit `value` to +-`limit`; 0 for NaN."""
    if value > limit:
        return limit
    if value < -limit:
        return -limit
    return value if value == value else 0.0


# NumPy division here and below: an exception is lost in compiled code that the master calls by address
@njit(cache=True, error_model="numpy", forceinline=True)
def friction_torque(parameters, anchors, leg, theta_l):
    """Return the torque (N m) of dry friction on a leg's joint, (P14)."""
    away = theta_l - anchors[leg, JOINT_ANCHOR]
    return _clamp(parameters.joint_friction / parameters.joint_presliding * away, parameters.joint_friction)


@njit(cache=True, forceinline=True)
def hysteresis_deflection(parameters, anchors, leg, d):
    """Return the deflection (rad) of a spring without hysteresis with the same torque as this spring at `d`, (P15)."""
    return d + _clamp(d - anchors[leg, SPRING_ANCHOR], parameters.spring_hysteresis * abs(d))


@njit(cache=True, forceinline=True)
def drag(parameters, anchors, leg, theta_l, d):
    """Move a leg's friction anchors, in place, as dragged by its joint at `theta_l` and its spring at `d` (rad)."""
    anchors[leg, JOINT_ANCHOR] = theta_l - _clamp(theta_l - anchors[leg, JOINT_ANCHOR], parameters.joint_presliding)
    anchors[leg, SPRING_ANCHOR] = d - _clamp(d - anchors[leg, SPRING_ANCHOR], parameters.spring_hysteresis * abs(d))


@njit(cache=True, error_model="numpy", forceinline=True)
def stop_deflection(parameters, d):
    """Return the deflection (rad) of a spring without a stop with the same torque as this spring at `d`."""
    over = abs(d) - parameters.spring_stop
    return d + math.copysign(parameters.stop / parameters.k_s * over, d) if over > 0.0 else d


@njit(cache=True, error_model="numpy")
def inverse_stop_deflection(parameters, d):
    """Return the deflection (rad) of a spring with a stop with the torque of a spring without one at `d`."""
    over = abs(d) - parameters.spring_stop
    return d - math.copysign(over - over / (1.0 + parameters.stop / parameters.k_s), d) if over > 0.0 else d


@njit(cache=True, forceinline=True)
def stop_torque(parameters, theta_l):
    """Return the torque (N m) of the hard stops on a joint outside its range; 0 within."""
    if theta_l > parameters.joint_upper:
        return parameters.stop * (parameters.joint_upper - theta_l)
    if theta_l < parameters.joint_lower:
        return parameters.stop * (parameters.joint_lower - theta_l)
    return 0.0
