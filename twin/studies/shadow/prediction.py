"""Prediction of the filter's state and covariance over one step, derived in docs/identification_method.md."""

import math

from twin.kernel.compiled.function import njit
from twin.robot.mechanism.geometry import LEG_COS, LEG_SIN, angle_near, leg_motion, leg_vectors, move_anchor
from twin.robot.plant.dynamics import acceleration_against, loaded_deflection, spring_stiffness
from twin.studies.shadow.layout import (
    FORCE,
    HEADING_SPEED,
    HEADING_TIME,
    MATRIX_WIDTH,
    MOTOR,
    POSITION,
    SPEED,
    STATES,
    TOUCH_FORCE,
    VELOCITY,
)

BY_ANGLE, BY_WAY, BY_SPEED = 3e-4, 1e-5, 1e-3
"""Steps of numerical derivatives (rad, m, m/s): the standard deviation of a motor angle, and the displacement that
turns a joint by half of it, so that a dead zone's edge is as soft as its position is uncertain."""


@njit(cache=True, error_model="numpy", forceinline=True)
def push(m, special, p, v, theta_m, F):
    return acceleration_against(m.parameters, p, v, theta_m, F, m.anchors, special)


@njit(cache=True, error_model="numpy", forceinline=True)
def triple(m, k):
    return m.x[k], m.x[k + 1], m.x[k + 2]


@njit(cache=True, error_model="numpy", forceinline=True)
def _shift(a, i, by):
    return a[0] + (by if i == 0 else 0.0), a[1] + (by if i == 1 else 0.0), a[2] + (by if i == 2 else 0.0)


@njit(cache=True, error_model="numpy", forceinline=True)
def _extrapolate(a, rate, t):
    return a[0] + t * rate[0], a[1] + t * rate[1], a[2] + t * rate[2]


@njit(cache=True, error_model="numpy")
def pose(m):
    """Compute joint angles and Jacobian at the estimated position in `m.theta_l`, `m.J`; NaN outside the workspace."""
    p = m.parameters
    for leg in range(3):
        k_r, k_z, r, w, h, q = leg_vectors(p, leg, m.x[0], m.x[1], m.x[2])
        move_anchor(p, m.anchors, leg, k_r, k_z)
        j_r, j_w, j_z, _, _ = leg_motion(p, k_r, k_z, r, w, h, q, 0.0, 0.0, 0.0)
        C, S = LEG_COS[leg], LEG_SIN[leg]
        m.J[leg, 0], m.J[leg, 1], m.J[leg, 2] = C * j_r - S * j_w, S * j_r + C * j_w, j_z
        m.theta_l[leg] = angle_near(m.anchors, leg, k_r, k_z)


@njit(cache=True, error_model="numpy")
def linearise(m, special):
    """Differentiate the plant's acceleration dv/dt by the filter's state into `m.slope`, by finite differences."""
    p, v, theta_m, F = triple(m, POSITION), triple(m, VELOCITY), triple(m, MOTOR), triple(m, FORCE)
    base = push(m, special, p, v, theta_m, F)
    for i in range(3):
        up = push(m, special, _shift(p, i, BY_WAY), v, theta_m, F)
        down = push(m, special, _shift(p, i, -BY_WAY), v, theta_m, F)
        high = push(m, special, p, v, _shift(theta_m, i, BY_ANGLE), F)
        low = push(m, special, p, v, _shift(theta_m, i, -BY_ANGLE), F)
        fast = push(m, special, p, _shift(v, i, BY_SPEED), theta_m, F)
        pressed = push(m, special, p, v, theta_m, _shift(F, i, 1.0))
        for k in range(3):
            m.slope[k, POSITION + i] = (up[k] - down[k]) / (2.0 * BY_WAY)
            m.slope[k, VELOCITY + i] = (fast[k] - base[k]) / BY_SPEED
            m.slope[k, MOTOR + i] = (high[k] - low[k]) / (2.0 * BY_ANGLE)
            m.slope[k, SPEED + i] = 0.0
            m.slope[k, FORCE + i] = pressed[k] - base[k]


@njit(cache=True, error_model="numpy", forceinline=True)
def stiffness(m, leg):
    """Compute a leg's stiffness d tau_load / d theta_m (N m/rad) and torque tau_load (N m); 0 inside the dead zone."""
    p, theta_m = m.parameters, m.x[MOTOR + leg]
    d = loaded_deflection(p, m.anchors, leg, theta_m, m.theta_l[leg])
    high = loaded_deflection(p, m.anchors, leg, theta_m + BY_ANGLE, m.theta_l[leg])
    low = loaded_deflection(p, m.anchors, leg, theta_m - BY_ANGLE, m.theta_l[leg])
    k = spring_stiffness(p, leg)
    return k * (high - low) / (2.0 * BY_ANGLE), k * d


@njit(cache=True, error_model="numpy")
def transition(m, h, E, reach, droop, K, turn):
    """Compute the filter's transition matrix d x(t + h) / d x(t) into `m.phi`: exact for the drives, a series to h^3
    for the platform.

    Args:
        h: step length (s).
        E: remaining share of a speed difference after h.
        reach: distance per speed difference in that time (s).
        droop: speed loss per load (rad/s per N m).
        K, turn: derivatives of the force, see `predict`.
    """
    phi, term, after, slope = m.phi, m.term, m.next, m.slope
    for i in range(STATES):
        for j in range(MATRIX_WIDTH):
            phi[i, j] = 0.0
        phi[i, i] = 1.0
    for leg in range(3):
        k, _ = stiffness(m, leg)
        w, a = SPEED + leg, MOTOR + leg
        phi[w, w], phi[a, w] = E, reach
        # the droop reduces the target speed
        phi[w, a], phi[a, a] = -(1.0 - E) * droop * k, 1.0 - (h - reach) * droop * k
        for i in range(3):
            by = droop * k * m.parameters.N * m.J[leg, i]
            phi[w, POSITION + i], phi[a, POSITION + i] = (1.0 - E) * by, (h - reach) * by
    # first derivative of (p, v), with the motors at their mid-step angles
    for i in range(3):
        for j in range(MATRIX_WIDTH):
            term[i, j] = 0.0
            term[3 + i, j] = 0.0
        term[i, VELOCITY + i] = 1.0
        for k in range(3):
            term[3 + i, POSITION + k] = slope[i, POSITION + k]
            term[3 + i, VELOCITY + k] = slope[i, VELOCITY + k]
            term[3 + i, FORCE + k] = slope[i, FORCE + k]
            term[3 + i, MOTOR + k] += 0.5 * slope[i, MOTOR + k]
        # the force at mid-step
        slope[i, VELOCITY + 2] += 0.5 * h * K * slope[i, FORCE + 2]
        term[3 + i, VELOCITY + 2] = slope[i, VELOCITY + 2]
        c, s = math.cos(0.5 * turn), math.sin(0.5 * turn)
        term[3 + i, FORCE] = c * slope[i, FORCE] + s * slope[i, FORCE + 1]
        term[3 + i, FORCE + 1] = c * slope[i, FORCE + 1] - s * slope[i, FORCE]
        for k in range(3):
            half = 0.5 * slope[i, MOTOR + k]
            for j in range(MATRIX_WIDTH):
                term[3 + i, j] += half * phi[MOTOR + k, j]
    share = h
    for order in range(2, 5):
        for i in range(6):
            for j in range(MATRIX_WIDTH):
                phi[i, j] += share * term[i, j]
        share *= h / order
        for i in range(3):
            for j in range(MATRIX_WIDTH):
                after[i, j] = term[3 + i, j]
                after[3 + i, j] = 0.0
            for k in range(6):
                by = slope[i, k]
                for j in range(MATRIX_WIDTH):
                    after[3 + i, j] += by * term[k, j]
        for i in range(6):
            for j in range(MATRIX_WIDTH):
                term[i, j] = after[i, j]
    for j in range(MATRIX_WIDTH):
        phi[FORCE + 2, j] += K * phi[POSITION + 2, j]
    phi[FORCE + 2, POSITION + 2] -= K
    c, s = math.cos(turn), math.sin(turn)
    phi[FORCE, FORCE], phi[FORCE, FORCE + 1] = c, -s
    phi[FORCE + 1, FORCE], phi[FORCE + 1, FORCE + 1] = s, c


@njit(cache=True, error_model="numpy")
def propagate_covariance(m):
    """Propagate the filter's covariance by the transition matrix: replace P by phi P phi^T."""
    P, phi, left = m.P, m.phi, m.left
    for i in range(STATES):
        for j in range(MATRIX_WIDTH):
            left[i, j] = 0.0
        for k in range(STATES):
            by = phi[i, k]
            if by != 0.0:
                for j in range(MATRIX_WIDTH):
                    left[i, j] += by * P[k, j]
    # the product is symmetric: compute the lower half, copy it
    for i in range(STATES):
        for j in range(i + 1):
            total = 0.0
            for k in range(MATRIX_WIDTH):
                total += left[i, k] * phi[j, k]
            P[i, j] = total
            P[j, i] = total


@njit(cache=True, error_model="numpy")
def wander(m, h, commanded, touching):
    """Add the process noise of half a step of `h` (s) to the filter's covariance P."""
    P, n = m.P, m.noises
    v = 0.5 * h * n.v * n.v
    own = m.drive.wander if commanded else n.omega
    omega = 0.5 * h * own * own
    v_x, v_y, v_z = triple(m, VELOCITY)
    own_F = n.F * n.F if touching else n.air * n.air
    across = n.mu * n.mu * (v_x * v_x + v_y * v_y) if touching else 0.0
    # in free air contact is uncertain
    unsure = m.parameters.K * (n.unsure if touching else 1.0)
    rate = n.touch * unsure * unsure
    F = 0.5 * h * (own_F + rate * (n.mu * n.mu * v_z * v_z + across))
    F_z = 0.5 * h * (own_F + rate * v_z * v_z)
    for i in range(3):
        P[VELOCITY + i, VELOCITY + i] += v
        P[SPEED + i, SPEED + i] += omega
        P[FORCE + i, FORCE + i] += F_z if i == 2 else F


@njit(cache=True, error_model="numpy")
def heading(m, h):
    """Compute the angle (rad) that the motion across the surface turns in `h` (s), from the slow velocity `m.slow`."""
    s_x, s_y, across = m.slow[0], m.slow[1], h / HEADING_TIME
    d_x, d_y = across * (m.x[VELOCITY] - s_x), across * (m.x[VELOCITY + 1] - s_y)
    m.slow[0], m.slow[1] = s_x + d_x, s_y + d_y
    return (s_x * d_y - s_y * d_x) / (s_x * s_x + s_y * s_y + HEADING_SPEED * HEADING_SPEED)


@njit(cache=True, error_model="numpy", forceinline=True)
def _rotate(F, by):
    c, s = math.cos(by), math.sin(by)
    return c * F[0] - s * F[1], s * F[0] + c * F[1], F[2]


@njit(cache=True, error_model="numpy")
def predict(m, h, special):
    """Predict the filter's state and covariance over `h` (s): Runge-Kutta for the platform, (6) of velocity_servo for
    the drives.

    The touched surface yields with the believed stiffness K, and friction turns with the direction of motion.
    """
    pose(m)
    touching = abs(m.x[FORCE + 2]) > TOUCH_FORCE
    turn = heading(m, h)
    # contact forces only push
    K, turn = (m.parameters.K, turn) if m.x[FORCE + 2] < -TOUCH_FORCE else (0.0, 0.0)
    commanded = not math.isnan(m.omega_ref[0] + m.omega_ref[1] + m.omega_ref[2])
    lag = m.drive.lag if commanded else math.inf
    E = math.exp(-h / lag)
    reach = lag * (1.0 - E) if commanded else h
    droop = m.drive.droop if commanded else 0.0
    linearise(m, special)
    transition(m, h, E, reach, droop, K, turn)
    wander(m, h, commanded, touching)
    propagate_covariance(m)
    wander(m, h, commanded, touching)
    p, v, start, before = triple(m, POSITION), triple(m, VELOCITY), triple(m, MOTOR), triple(m, FORCE)
    for leg in range(3):
        _, tau_load = stiffness(m, leg)
        omega = m.x[SPEED + leg]
        target = m.omega_ref[leg] - droop * tau_load if commanded else omega
        m.x[MOTOR + leg] += target * h + (omega - target) * reach
        m.x[SPEED + leg] = target + (omega - target) * E
    end, half = triple(m, MOTOR), 0.5 * h
    middle = _extrapolate(start, (end[0] - start[0], end[1] - start[1], end[2] - start[2]), 0.5)
    F_x, F_y, F_z = _rotate(before, 0.5 * turn)
    F = F_x, F_y, F_z + half * K * v[2]
    a = push(m, special, p, v, start, F)
    v_2 = _extrapolate(v, a, half)
    a_2 = push(m, special, _extrapolate(p, v, half), v_2, middle, F)
    v_3 = _extrapolate(v, a_2, half)
    a_3 = push(m, special, _extrapolate(p, v_2, half), v_3, middle, F)
    v_4 = _extrapolate(v, a_3, h)
    a_4 = push(m, special, _extrapolate(p, v_3, h), v_4, end, F)
    for i in range(3):
        m.x[POSITION + i] += h * (v[i] + 2.0 * v_2[i] + 2.0 * v_3[i] + v_4[i]) / 6.0
        m.x[VELOCITY + i] += h * (a[i] + 2.0 * a_2[i] + 2.0 * a_3[i] + a_4[i]) / 6.0
    m.x[FORCE], m.x[FORCE + 1], _ = _rotate(before, turn)
    m.x[FORCE + 2] += K * (m.x[POSITION + 2] - p[2])
