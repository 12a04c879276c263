"""Contact of the platform with a surface: its shape, a normal force by a contact law, tangential bristle friction.

The surface passes through its apex (0, 0, z_s). Its axes there are the axes of B, turned by tilt_x about x and then by
tilt about y, R = R_y(tilt) R_x(tilt_x): tangents R e_x, R e_y, normal R e_z. They are the same everywhere on a plane. A
sphere or cylinder of radius R lies below its apex; depth is R less the distance from its centre or axis (the signed
distance, positive inside), the normal is the gradient of that distance.

Positions and velocities of the head are relative to the surface, so a moving surface is subtracted before. The bristle
obeys dz_b/dt = v_t, and is kept on the friction cone by return mapping after each step (`settled_bristle`). That is
stable at any normal force, also at mu = 0, where the usual rate form v_t - sigma_0 |v_t| z_b / (mu F_n) divides by zero
and is stiff at a light touch.

On a curved surface z_b is expressed in the tangents of `surface_frame`; their rotation about the normal is neglected in
dz_b/dt. It would transfer no energy; on a closed path it equals the solid angle enclosed by n.
"""

import math
from enum import IntEnum

from twin.kernel.compiled.function import njit
from twin.robot.plant.contact_law import pressing_force

JOINT_ANCHOR, SPRING_ANCHOR = 3, 4
"""Columns of the plant's anchors with theta_0 and d_0 (rad), after the columns of `angle_near`."""
CONE_ROUNDING = 1e-9
"""Relative tolerance within which a bristle counts as being at its limit."""


class Shape(IntEnum):
    """Shape of the contact surface, named as in an experiment's file, in capitals; a cylinder after its axis."""

    PLANE = 0
    SPHERE = 1
    CYLINDER_X = 2
    CYLINDER_Y = 3


@njit(cache=True, forceinline=True)
def dot(a, x, y, z):
    """Return the scalar product of the triple `a` with (x, y, z)."""
    return a[0] * x + a[1] * y + a[2] * z


@njit(cache=True)
def apex_frame(parameters):
    """Return tangents e_1, e_2 and normal n of the surface at its apex, triples in frame B."""
    sin_t, cos_t = math.sin(parameters.tilt), math.cos(parameters.tilt)
    sin_x, cos_x = math.sin(parameters.tilt_x), math.cos(parameters.tilt_x)
    e_1 = (cos_t, 0.0, -sin_t)
    e_2 = (sin_t * sin_x, cos_x, cos_t * sin_x)
    n = (sin_t * cos_x, -sin_x, cos_t * cos_x)
    return e_1, e_2, n


# NumPy division: at a sphere's centre the normal must become NaN, because an exception is lost in compiled code that
# the master calls by address
@njit(cache=True, error_model="numpy")
def surface_frame(parameters, x, y, z):
    """Return penetration depth (m) and local surface frame (e_1, e_2, n) at the head's position (x, y, z).

    The frame consists of tangents e_1, e_2 and normal n, triples in B. On a curved surface the tangents are the apex's,
    carried along the great circle (the smallest rotation from one normal to the other): they depend smoothly on the
    position, and are constant along a cylinder's axis.
    """
    head = parameters.head
    return frame_at(parameters, apex_frame(parameters), x + head[0], y + head[1], z + head[2])


@njit(cache=True)
def surface_depth(parameters, x, y, z):
    """Return the depth (m, positive inside) of the head in the surface, with O_P at (x, y, z) of B."""
    head, apex = parameters.head, apex_frame(parameters)
    x, y, z = x + head[0], y + head[1], z + head[2]
    if parameters.shape == Shape.PLANE:
        return plane_depth(parameters, apex[2], x, y, z)
    return depth_and_offset(parameters, apex, x, y, z)[0]


@njit(cache=True, forceinline=True)
def plane_depth(parameters, normal, x, y, z):
    """Return the depth (m) of the point (x, y, z) below a plane surface."""
    return -normal[0] * x - normal[1] * y + normal[2] * (parameters.z_s - z)


@njit(cache=True, forceinline=True)
def depth_and_offset(parameters, apex, x, y, z):
    """Return the depth (m) of a point in a curved surface, and its offset from the surface's centre or axis.

    The offset is given in the apex's axes, followed by its length (m).
    """
    a_1, a_2, a_3 = apex
    R = parameters.radius
    height = z - parameters.z_s
    w_1, w_2, w_3 = dot(a_1, x, y, height), dot(a_2, x, y, height), dot(a_3, x, y, height)
    if parameters.shape == Shape.CYLINDER_X:
        w_1 = 0.0
    if parameters.shape == Shape.CYLINDER_Y:
        w_2 = 0.0
    distance = math.sqrt(w_1 * w_1 + w_2 * w_2 + (w_3 + R) * (w_3 + R))
    # R - distance without cancellation at a large R
    depth = -(w_1 * w_1 + w_2 * w_2 + w_3 * w_3 + 2.0 * R * w_3) / (distance + R)
    return depth, w_1, w_2, w_3 + R, distance


@njit(cache=True, error_model="numpy", forceinline=True)
def frame_at(parameters, apex, x, y, z):
    """Return depth and local frame at the point (x, y, z) of the surface, from the frame at the apex."""
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
    """Return the vector with components x, y, z along the axes a_1, a_2, a_3 as a triple in frame B."""
    return (
        a_1[0] * x + a_2[0] * y + a_3[0] * z,
        a_1[1] * x + a_2[1] * y + a_3[1] * z,
        a_1[2] * x + a_2[2] * y + a_3[2] * z,
    )


@njit(cache=True)
def normal_force(parameters, apex, x, y, z, vx, vy, vz):
    """Return the contact's normal force (N, >= 0) and depth (m) at a position and velocity of the platform.

    `apex` is the surface's frame at its apex, here and below; it is computed once for all positions.
    """
    depth, _, _, n = frame_at(parameters, apex, x, y, z)
    return pressing_force(parameters, depth, -dot(n, vx, vy, vz)), depth


# NumPy division here and below: out of reach 0/0 must become NaN, because an exception is lost in compiled code that
# the master calls by address
@njit(cache=True, error_model="numpy", forceinline=True)
def _shorten(x, y, limit):
    """Return the vector (x, y), shortened to length `limit` if it is longer."""
    length = math.sqrt(x * x + y * y)
    if length <= limit:
        return x, y
    return x * (limit / length), y * (limit / length)


@njit(cache=True, forceinline=True)
def settled_bristle(parameters, F_n, z_1, z_2):
    """Scale the friction bristle back onto the cone sigma_0 |z_b| <= mu F_n; zero without contact."""
    return _shorten(z_1, z_2, parameters.mu * F_n / parameters.sigma_0)


@njit(cache=True, forceinline=True)
def friction(parameters, F_n, z_1, z_2, v_1, v_2):
    """Return the friction force BY the robot ON the surface along e_1, e_2 (N): sigma_0 z_b + sigma_1 v_t.

    It is kept inside the cone mu F_n.
    """
    z_1, z_2 = settled_bristle(parameters, F_n, z_1, z_2)
    f_1 = parameters.sigma_0 * z_1 + parameters.sigma_1 * v_1
    f_2 = parameters.sigma_0 * z_2 + parameters.sigma_1 * v_2
    return _shorten(f_1, f_2, parameters.mu * F_n)


@njit(cache=True, error_model="numpy", forceinline=True)
def bristle_rate(parameters, F_n, z_1, z_2, v_1, v_2):
    """Return the bristle's rate dz_b/dt (m/s): tangential speed without the part that stretches a sliding bristle."""
    limit = parameters.mu * F_n / parameters.sigma_0
    length = math.sqrt(z_1 * z_1 + z_2 * z_2)
    # return mapping leaves a sliding bristle at the limit: its last bit must not decide whether it slides
    if length < limit * (1.0 - CONE_ROUNDING):
        return v_1, v_2
    if limit == 0.0:
        return 0.0, 0.0
    outward = (z_1 * v_1 + z_2 * v_2) / (length * length)
    if outward <= 0.0:
        return v_1, v_2
    return v_1 - outward * z_1, v_2 - outward * z_2


@njit(cache=True, forceinline=True)
def touch(parameters, apex, x, y, z, vx, vy, vz, z_1, z_2):
    """Return force, normal force and bristle rate of the contact: (fx, fy, fz, F_n, dz_1, dz_2).

    Force BY the robot ON the surface in B (N; pressing gives fz < 0), normal force (N, >= 0), bristle rate (m/s).
    """
    depth, e_1, e_2, n = frame_at(parameters, apex, x, y, z)
    F_n = pressing_force(parameters, depth, -dot(n, vx, vy, vz))
    v_1, v_2 = dot(e_1, vx, vy, vz), dot(e_2, vx, vy, vz)
    f_1, f_2 = friction(parameters, F_n, z_1, z_2, v_1, v_2)
    dz_1, dz_2 = bristle_rate(parameters, F_n, z_1, z_2, v_1, v_2)
    return (
        e_1[0] * f_1 + e_2[0] * f_2 - n[0] * F_n,
        e_1[1] * f_1 + e_2[1] * f_2 - n[1] * F_n,
        e_1[2] * f_1 + e_2[2] * f_2 - n[2] * F_n,
        F_n,
        dz_1,
        dz_2,
    )


@njit(cache=True)
def contact_force(parameters, x, y, z, vx, vy, vz, z_1, z_2):
    """Return the contact force (fx, fy, fz) BY the robot ON the surface in B (N); pressing gives fz < 0."""
    x, y, z = x + parameters.head[0], y + parameters.head[1], z + parameters.head[2]
    fx, fy, fz, _, _, _ = touch(parameters, apex_frame(parameters), x, y, z, vx, vy, vz, z_1, z_2)
    return fx, fy, fz
