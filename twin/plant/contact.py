"""Contact with the electronic scale: Hunt-Crossley normal force, bristle friction, a plane that may be tilted.

The surface passes through (0, 0, z_s) with normal n = (sin t, 0, cos t), t the tilt about y; its tangents are
e_1 = (cos t, 0, -sin t) and e_2 = e_y. The bristle obeys dz_b/dt = v_t, and is kept on the friction cone by return
mapping after each step (`settled_bristle`). That is stable at any normal force, also at mu = 0, where the usual rate
form v_t - sigma_0 |v_t| z_b / (mu F_n) divides by zero and is stiff at a light touch.
"""

import math

from numba import njit


@njit(cache=True)
def normal(parameters):
    """(sin t, cos t): x and z component of the surface normal."""
    return math.sin(parameters.tilt), math.cos(parameters.tilt)


@njit(cache=True)
def normal_force(parameters, x, y, z, vx, vy, vz):
    """Normal force (N, >= 0) and penetration (m, positive inside) at position and velocity of the platform.

    Hunt and Crossley (1975) with exponent 1: F_n = max(0, K d (1 + damping d_dot)).
    """
    sin_t, cos_t = normal(parameters)
    depth = -sin_t * x + cos_t * (parameters.z_s - z)
    if depth <= 0.0:
        return 0.0, depth
    rate = -sin_t * vx - cos_t * vz
    force = parameters.K * depth * (1.0 + parameters.damping * rate)
    return max(force, 0.0), depth


@njit(cache=True)
def tangential_velocity(parameters, vx, vy, vz):
    """Velocity along e_1 and e_2 (m/s)."""
    sin_t, cos_t = normal(parameters)
    return cos_t * vx - sin_t * vz, vy


# numpy's division here and below: out of reach 0/0 has to become NaN, because an exception of compiled code that the
# master calls by address is lost
@njit(cache=True, error_model="numpy")
def _within(x, y, limit):
    """The vector (x, y), shortened to length `limit` if it is longer."""
    length = math.sqrt(x * x + y * y)
    if length <= limit:
        return x, y
    return x * (limit / length), y * (limit / length)


@njit(cache=True)
def settled_bristle(parameters, F_n, z_1, z_2):
    """Return mapping: the bristle scaled back so that sigma_0 |z_b| <= mu F_n; without contact it is straight."""
    return _within(z_1, z_2, parameters.mu * F_n / parameters.sigma_0)


@njit(cache=True)
def friction(parameters, F_n, z_1, z_2, v_1, v_2):
    """Force BY the robot ON the surface along e_1, e_2 (N): sigma_0 z_b + sigma_1 v_t, kept inside the cone mu F_n."""
    z_1, z_2 = settled_bristle(parameters, F_n, z_1, z_2)
    f_1 = parameters.sigma_0 * z_1 + parameters.sigma_1 * v_1
    f_2 = parameters.sigma_0 * z_2 + parameters.sigma_1 * v_2
    return _within(f_1, f_2, parameters.mu * F_n)


@njit(cache=True, error_model="numpy")
def bristle_rate(parameters, F_n, z_1, z_2, v_1, v_2):
    """dz_b/dt (m/s): the tangential velocity, less what would stretch a bristle that already slides."""
    limit = parameters.mu * F_n / parameters.sigma_0
    length = math.sqrt(z_1 * z_1 + z_2 * z_2)
    if length < limit:
        return v_1, v_2
    if limit == 0.0:
        return 0.0, 0.0
    outward = (z_1 * v_1 + z_2 * v_2) / (length * length)
    if outward <= 0.0:
        return v_1, v_2
    return v_1 - outward * z_1, v_2 - outward * z_2


@njit(cache=True)
def contact_force(parameters, x, y, z, vx, vy, vz, z_1, z_2):
    """Force BY the robot ON the surface in B (N): (fx, fy, fz), pressing gives fz < 0."""
    F_n, _ = normal_force(parameters, x, y, z, vx, vy, vz)
    v_1, v_2 = tangential_velocity(parameters, vx, vy, vz)
    f_1, f_2 = friction(parameters, F_n, z_1, z_2, v_1, v_2)
    sin_t, cos_t = normal(parameters)
    return cos_t * f_1 - sin_t * F_n, f_2, -sin_t * f_1 - cos_t * F_n
