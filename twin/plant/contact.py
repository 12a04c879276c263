"""Contact of the platform with a surface: normal force by a contact law, bristle friction in the tangent plane.

Positions and velocities are those of the head as seen from the surface: a surface that moves is subtracted before.
The bristle obeys dz_b/dt = v_t, and is kept on the friction cone by return mapping after each step
(`settled_bristle`). That is stable at any normal force, also at mu = 0, where the usual rate form
v_t - sigma_0 |v_t| z_b / (mu F_n) divides by zero and is stiff at a light touch.

On a curved surface z_b is held in the tangents of `surface.surface_frame`; the turning of these about the normal is
left out of dz_b/dt. It would move no energy, and on a closed path it is the solid angle that n goes round.
"""

import math

from twin.compiled.function import njit
from twin.plant.contact_law import pressing_force
from twin.plant.surface import apex_frame, dot, frame_at

ROUNDING = 1e-9
"""How near (of it) to its limit a bristle is at the limit."""


@njit(cache=True)
def normal_force(parameters, apex, x, y, z, vx, vy, vz):
    """Normal force (N, >= 0) and depth (m, positive inside) at position and velocity of the platform.

    `apex` is the surface's frame at its apex, here and below: it is the same at all positions.
    """
    depth, _, _, n = frame_at(parameters, apex, x, y, z)
    return pressing_force(parameters, depth, -dot(n, vx, vy, vz)), depth


# numpy's division here and below: out of reach 0/0 has to become NaN, because an exception of compiled code that the
# master calls by address is lost
@njit(cache=True, error_model="numpy", forceinline=True)
def _within(x, y, limit):
    """The vector (x, y), shortened to length `limit` if it is longer."""
    length = math.sqrt(x * x + y * y)
    if length <= limit:
        return x, y
    return x * (limit / length), y * (limit / length)


@njit(cache=True, forceinline=True)
def settled_bristle(parameters, F_n, z_1, z_2):
    """Return mapping: the bristle scaled back so that sigma_0 |z_b| <= mu F_n; without contact it is straight."""
    return _within(z_1, z_2, parameters.mu * F_n / parameters.sigma_0)


@njit(cache=True, forceinline=True)
def friction(parameters, F_n, z_1, z_2, v_1, v_2):
    """Force BY the robot ON the surface along e_1, e_2 (N): sigma_0 z_b + sigma_1 v_t, kept inside the cone mu F_n."""
    z_1, z_2 = settled_bristle(parameters, F_n, z_1, z_2)
    f_1 = parameters.sigma_0 * z_1 + parameters.sigma_1 * v_1
    f_2 = parameters.sigma_0 * z_2 + parameters.sigma_1 * v_2
    return _within(f_1, f_2, parameters.mu * F_n)


@njit(cache=True, error_model="numpy", forceinline=True)
def bristle_rate(parameters, F_n, z_1, z_2, v_1, v_2):
    """dz_b/dt (m/s): the tangential velocity, less what would stretch a bristle that already slides."""
    limit = parameters.mu * F_n / parameters.sigma_0
    length = math.sqrt(z_1 * z_1 + z_2 * z_2)
    # return mapping leaves a sliding bristle at the limit: the last bit must not say whether it slides
    if length < limit * (1.0 - ROUNDING):
        return v_1, v_2
    if limit == 0.0:
        return 0.0, 0.0
    outward = (z_1 * v_1 + z_2 * v_2) / (length * length)
    if outward <= 0.0:
        return v_1, v_2
    return v_1 - outward * z_1, v_2 - outward * z_2


@njit(cache=True, forceinline=True)
def touch(parameters, apex, x, y, z, vx, vy, vz, z_1, z_2):
    """All that a contact does at once: (fx, fy, fz, F_n, dz_1, dz_2).

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
    """Force BY the robot ON the surface in B (N) with O_P at (x, y, z): (fx, fy, fz), pressing gives fz < 0."""
    x, y, z = x + parameters.head[0], y + parameters.head[1], z + parameters.head[2]
    fx, fy, fz, _, _, _ = touch(parameters, apex_frame(parameters), x, y, z, vx, vy, vz, z_1, z_2)
    return fx, fy, fz
