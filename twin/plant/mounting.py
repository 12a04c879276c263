"""How the robot is mounted: which way is up, seen from its base.

The base may be tilted out of the level about two axes, R = R_y(tilt) R_x(tilt_x) as with a surface. Then up is
R^T e_z, and all that weighs weighs along it. The robot's computer knows no tilt: it takes off a weight along z of B.
"""

import math

import numpy as np

from twin.compiled.function import njit
from twin.robot.geometry import LEG_COS, LEG_SIN
from twin.robot.gravity import arm_weight


@njit(cache=True, forceinline=True)
def upward(parameters):
    """Unit vector against gravity in base frame B, a triple."""
    if parameters.mounting_tilt == 0.0 and parameters.mounting_tilt_x == 0.0:
        return 0.0, 0.0, 1.0
    sin_t, cos_t = math.sin(parameters.mounting_tilt), math.cos(parameters.mounting_tilt)
    sin_x, cos_x = math.sin(parameters.mounting_tilt_x), math.cos(parameters.mounting_tilt_x)
    return -sin_t, cos_t * sin_x, cos_t * cos_x


@njit(cache=True, forceinline=True)
def hanging(up, leg, k_r, k_z):
    """Lever (m) of a weight at the knee (k_r, k_z) of `leg`: what it turns the joint by is weight times this."""
    return up[2] * k_r - (LEG_COS[leg] * up[0] + LEG_SIN[leg] * up[1]) * k_z


@njit(cache=True)
def arm_torque(parameters, up, leg, theta_l):
    """Torque (N m) with which the weight of the arm of `leg` turns its joint at the angle `theta_l` (rad)."""
    return arm_weight(parameters) * parameters.l_a * hanging(up, leg, np.cos(theta_l), -np.sin(theta_l))
