"""The shape of what the robot presses on: depth, normal and tangents at a point.

The surface passes through its apex (0, 0, z_s). Its axes there are those of B, turned by tilt_x about x and then by
tilt about y, R = R_y(tilt) R_x(tilt_x): tangents R e_x, R e_y, normal R e_z. A plane has them everywhere. A sphere or
cylinder of radius R lies below its apex; depth is R less the distance from its centre or axis (the signed distance,
positive inside), the normal is the gradient of that distance.

How the robot is mounted: which way is up, seen from its base. The base may be tilted out of the level about two axes, R
= R_y(tilt) R_x(tilt_x) as with a surface. Then up is R^T e_z, and all that weighs weighs along it. The robot's computer
knows no tilt: it takes off a weight along z of B.
"""

import math
from enum import IntEnum

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


class Shape(IntEnum):
    """By the names in an experiment's file, in capitals. Cylinders are named after the axis they lie along."""

    PLANE = 0
    SPHERE = 1
    CYLINDER_X = 2
    CYLINDER_Y = 3


@njit(cache=True, forceinline=True)
def dot(a, x, y, z):
    """Scalar product of the triple `a` with (x, y, z)."""
    return a[0] * x + a[1] * y + a[2] * z


@njit(cache=True)
def apex_frame(parameters):
    """Tangents e_1, e_2 and normal n of the surface at its apex, triples in B."""
    sin_t, cos_t = math.sin(parameters.tilt), math.cos(parameters.tilt)
    sin_x, cos_x = math.sin(parameters.tilt_x), math.cos(parameters.tilt_x)
    e_1 = (cos_t, 0.0, -sin_t)
    e_2 = (sin_t * sin_x, cos_x, cos_t * sin_x)
    n = (sin_t * cos_x, -sin_x, cos_t * cos_x)
    return e_1, e_2, n


# numpy's division: at a sphere's centre the normal has to become NaN, because an exception of compiled code that the
# master calls by address is lost
@njit(cache=True, error_model="numpy")
def surface_frame(parameters, x, y, z):
    """Depth (m, positive inside) and local tangents e_1, e_2 and normal n, triples in B, where the head is when O_P is
    at (x, y, z) of B.

    On a curved surface the tangents are the apex's, carried along the great circle (the smallest turn that takes one
    normal to the other): they depend smoothly on the position, and along a cylinder's axis not at all.
    """
    head = parameters.head
    return frame_at(parameters, apex_frame(parameters), x + head[0], y + head[1], z + head[2])


@njit(cache=True)
def surface_depth(parameters, x, y, z):
    """Depth (m, positive inside) of the head when O_P is at (x, y, z) of B."""
    head, apex = parameters.head, apex_frame(parameters)
    x, y, z = x + head[0], y + head[1], z + head[2]
    if parameters.shape == Shape.PLANE:
        return plane_depth(parameters, apex[2], x, y, z)
    return depth_and_offset(parameters, apex, x, y, z)[0]


@njit(cache=True, forceinline=True)
def plane_depth(parameters, normal, x, y, z):
    """Depth (m) below a plane at (x, y, z)."""
    return -normal[0] * x - normal[1] * y + normal[2] * (parameters.z_s - z)


@njit(cache=True, forceinline=True)
def depth_and_offset(parameters, apex, x, y, z):
    """Depth (m) in a curved surface at (x, y, z), the offset from its centre or axis along the apex's axes and the
    offset's length (m)."""
    a_1, a_2, a_3 = apex
    R = parameters.radius
    height = z - parameters.z_s
    w_1, w_2, w_3 = dot(a_1, x, y, height), dot(a_2, x, y, height), dot(a_3, x, y, height)
    if parameters.shape == Shape.CYLINDER_X:
        w_1 = 0.0
    if parameters.shape == Shape.CYLINDER_Y:
        w_2 = 0.0
    distance = math.sqrt(w_1 * w_1 + w_2 * w_2 + (w_3 + R) * (w_3 + R))
    # R - distance without the cancellation that a large R would bring
    depth = -(w_1 * w_1 + w_2 * w_2 + w_3 * w_3 + 2.0 * R * w_3) / (distance + R)
    return depth, w_1, w_2, w_3 + R, distance


@njit(cache=True, error_model="numpy", forceinline=True)
def frame_at(parameters, apex, x, y, z):
    """As `surface_frame`, at (x, y, z) itself; `apex` is the frame at the apex."""
    a_1, a_2, a_3 = apex
    if parameters.shape == Shape.PLANE:
        return plane_depth(parameters, a_3, x, y, z), a_1, a_2, a_3
    depth, w_1, w_2, w_3, distance = depth_and_offset(parameters, apex, x, y, z)
    n_1, n_2, n_3 = w_1 / distance, w_2 / distance, w_3 / distance
    turn = 1.0 / (1.0 + n_3)
    e_1 = _in_B(a_1, a_2, a_3, 1.0 - turn * n_1 * n_1, -turn * n_1 * n_2, -n_1)
    e_2 = _in_B(a_1, a_2, a_3, -turn * n_1 * n_2, 1.0 - turn * n_2 * n_2, -n_2)
    return depth, e_1, e_2, _in_B(a_1, a_2, a_3, n_1, n_2, n_3)


@njit(cache=True)
def _in_B(a_1, a_2, a_3, x, y, z):
    """The vector with components x, y, z along a_1, a_2, a_3, as a triple in B."""
    return (
        a_1[0] * x + a_2[0] * y + a_3[0] * z,
        a_1[1] * x + a_2[1] * y + a_3[1] * z,
        a_1[2] * x + a_2[2] * y + a_3[2] * z,
    )
