"""The state of a running robot from its encoder counts: an extended Kalman filter, one compiled step a sample.

x = (p_B, v_B, theta_m, omega_m, F_ee_B), three of each. The platform moves as the plant does (P5), whatever it presses
on being a force that wanders; the drives follow their commands with a lag and give way under load (P12):

    dp/dt = v,  dv/dt = a(p, v, theta_m, F) + n_v,  d theta_m/dt = omega,
    d omega/dt = (omega_ref - droop tau_load - omega)/T_m + n_omega,  dF/dt = n_F.

Measured are theta_m and theta_l(p) by counts. docs/shadow_method.md has the derivation, where the noises come from, and
what six counts cannot tell. A motor's torque and a measured force are compared with the estimate and do not enter it:
what is to contradict an estimate may not be a part of it.
"""

import math
from typing import NamedTuple

from twin.kernel.compiled.function import njit
from twin.kernel.cosim.component import NativeComponent, step_function
from twin.kernel.cosim.port import Port, memory_of, record, record_of, state, states
from twin.robot.controller.controller import BELIEF, Belief, angle
from twin.robot.mechanism.geometry import LEG_COS, LEG_SIN, angle_near, leg_motion, leg_vectors, move_anchor
from twin.robot.mechanism.kinematics import platform_position
from twin.robot.plant.contact import ANCHORS
from twin.robot.plant.dynamics import (
    PARAMETERS,
    UNTOUCHED,
    PlantParameters,
    acceleration_against,
    has_effects,
    loaded_deflection,
    spring_stiffness,
)


class DriveModel(NamedTuple):
    """What is known of the drives, SI.

    Attributes:
        lag: T_m (s), 0: the speed is the commanded one.
        droop: rad/s per N m.
        inertia: of a rotor (kg m2), for the motor's torque.
        wander: intensity of what their acceleration does besides (rad/s2/sqrt(Hz)).
    """

    lag: float
    droop: float
    inertia: float
    wander: float


class Noises(NamedTuple):
    """How much of what the filter knows nothing of there is, SI; see docs/shadow_method.md.

    Attributes:
        v: intensity of accelerations that the mechanism does not have (m/s2/sqrt(Hz)).
        F: intensity of the wander of a force on a platform that stands (N/sqrt(s)).
        K: stiffness (N/m) by which the force changes with the way of the platform.
        touch: for how long (s) such a change goes on in one sense.
        omega: intensity of the wander of a motor's acceleration whose command is not known (rad/s2/sqrt(Hz)).
    """

    v: float = 1e-3
    F: float = 0.4
    air: float = 0.05
    K: float = 1500.0
    mu: float = 0.3
    touch: float = 2e-3
    omega: float = 5.0


class Sensors(NamedTuple):
    """Deviation (rad) of the encoders' white noise, besides their rounding."""

    motor_noise: float
    joint_noise: float


STATES = 15
WIDE = 16
"""Columns of a matrix: whole registers of four."""
POSITION, VELOCITY, MOTOR, SPEED, FORCE = 0, 3, 6, 9, 12
"""Where each triple begins in the state."""
COUNTS = 6
LONGEST_STEP = 2.5e-3
"""s. The springs' fastest swing, 120 rad/s, turns by 0.3 rad in it; see docs/physics.md."""
LONGEST_GAP = 0.1
"""s. After more than that nothing is known of the motors' way; the filter starts anew."""
DITHERED = 0.5
"""Deviation of an encoder's noise, in counts, from which on rounding is white: each sample is a new measurement."""
TOUCHED = 0.3
"""N. Pressing less than that the robot is in free air, where a force does not wander."""
EDGE = 0.1
"""Counts. Where a count changes is not known better than that."""
JUST_CHANGED = math.sqrt(3.0)
"""Counts. Evenly spread over so much, an error has a deviation of half a count."""
REPEATED = 0.004
"""s. A count that stays is taken in again after so long; until then it tells what it has told before."""
GARBLED = 1e4
"""Squared deviations. A count so far off is told and not taken in; if it goes on for `LONGEST_GAP` it is believed."""
MOVED = 0.1
"""s. If no count has changed for so long the robot stands still."""
FIRST = (1e-3, 0.05, 1e-3, 0.5, 1.0)
"""Deviations of position, velocity, motor angle, its speed and force in the beginning, SI."""
NO_POSE = 2
RUNNING, LOST = 1, 2
"""What the filter is doing: following, or waiting for counts that fit a pose again; 0: not begun."""

INPUTS = (
    Port("count_m", 3, "1", "motor encoder counts; NaN: none came"),
    Port("count_l", 3, "1", "joint encoder counts; NaN: none came"),
    Port("omega_ref", 3, "rad/s", "motor speeds commanded from this sample on; NaN: not known"),
    Port("F_z", 1, "N", "measured pressing force; NaN: none"),
    Port("tau_motor", 3, "N m", "torque of the motors, by their currents; NaN: none"),
)
OUTPUTS = (
    Port("p_B", 3, "m", "estimated platform position, base frame B"),
    Port("v_B", 3, "m/s", "estimated platform velocity, base frame B"),
    Port("theta_m", 3, "rad", "estimated motor angles"),
    Port("omega_m", 3, "rad/s", "estimated motor speeds"),
    Port("F_ee_B", 3, "N", "estimated force by the robot on the environment, base frame B"),
    Port("deviation", STATES, "SI", "standard deviations of these"),
    Port("residual_m", 3, "rad", "motor angles by counts less what was expected; NaN: none"),
    Port("residual_l", 3, "rad", "joint angles by counts less what was expected; NaN: none"),
    Port("residual_F", 1, "N", "measured pressing force less what was expected; NaN: none"),
    Port("residual_tau", 3, "N m", "motor torques less what was expected; NaN: none"),
    Port("NIS", 1, "1", "squared residuals of the counts by their variances; NaN: none told something new"),
    Port("used", 1, "1", "how many counts told something new", "int"),
    Port("moves", 1, "1", "whether a count has changed within the last 0.1 s", "bool"),
    Port("started", 1, "1", "whether the filter has started anew with this sample", "bool"),
)
MATRIX = ("f8", (STATES, WIDE))
MEMORY = record(
    parameters=PARAMETERS,
    belief=BELIEF,
    drive=record_of(DriveModel),
    noises=record_of(Noises),
    sensors=record_of(Sensors),
    **states(
        x=("f8", (STATES,)),
        P=MATRIX,
        anchors=("f8", (3, ANCHORS)),
        omega_ref="3f8",
        counts=("f8", (COUNTS,)),
        kept=("f8", (COUNTS,)),
        still="f8",
        refused=("f8", (COUNTS,)),
        on="i8",
    ),
    # of one step
    slope=("f8", (3, STATES)),
    J=("f8", (3, 3)),
    theta_l="3f8",
    phi=MATRIX,
    left=MATRIX,
    term=("f8", (6, WIDE)),
    next=("f8", (6, WIDE)),
    before=("f8", (COUNTS,)),
    nu=("f8", (COUNTS,)),
    R=("f8", (COUNTS,)),
    PH=("f8", (WIDE,)),
    total=("f8", (STATES,)),
)


@njit(cache=True, error_model="numpy", forceinline=True)
def _push(m, special, p, v, theta_m, F):
    return acceleration_against(m.parameters, p, v, theta_m, F, m.anchors, special)


@njit(cache=True, error_model="numpy", forceinline=True)
def _at(m, k):
    return m.x[k], m.x[k + 1], m.x[k + 2]


@njit(cache=True, error_model="numpy", forceinline=True)
def _shifted(a, i, by):
    return a[0] + (by if i == 0 else 0.0), a[1] + (by if i == 1 else 0.0), a[2] + (by if i == 2 else 0.0)


@njit(cache=True, error_model="numpy", forceinline=True)
def _ahead(a, rate, t):
    return a[0] + t * rate[0], a[1] + t * rate[1], a[2] + t * rate[2]


@njit(cache=True, error_model="numpy")
def pose(m):
    """Joint angles and Jacobian of the estimated position into `m.theta_l` and `m.J`; NaN outside the workspace."""
    p = m.parameters
    for leg in range(3):
        k_r, k_z, r, w, h, q = leg_vectors(p, leg, m.x[0], m.x[1], m.x[2])
        move_anchor(p, m.anchors, leg, k_r, k_z)
        j_r, j_w, j_z, _, _ = leg_motion(p, k_r, k_z, r, w, h, q, 0.0, 0.0, 0.0)
        C, S = LEG_COS[leg], LEG_SIN[leg]
        m.J[leg, 0], m.J[leg, 1], m.J[leg, 2] = C * j_r - S * j_w, S * j_r + C * j_w, j_z
        m.theta_l[leg] = angle_near(m.anchors, leg, k_r, k_z)


BY_ANGLE, BY_WAY, BY_SPEED = 3e-4, 1e-5, 1e-3
"""rad, m, m/s. Slopes are taken across so much: the deviation of a motor's angle, and what turns a joint by half of
that, so that the edge of a dead zone is as soft as it is known."""


@njit(cache=True, error_model="numpy")
def linearise(m, special):
    """How dv/dt depends on the state, into `m.slope`: differences of the plant's own equation."""
    p, v, theta_m, F = _at(m, POSITION), _at(m, VELOCITY), _at(m, MOTOR), _at(m, FORCE)
    base = _push(m, special, p, v, theta_m, F)
    for i in range(3):
        up = _push(m, special, _shifted(p, i, BY_WAY), v, theta_m, F)
        down = _push(m, special, _shifted(p, i, -BY_WAY), v, theta_m, F)
        high = _push(m, special, p, v, _shifted(theta_m, i, BY_ANGLE), F)
        low = _push(m, special, p, v, _shifted(theta_m, i, -BY_ANGLE), F)
        fast = _push(m, special, p, _shifted(v, i, BY_SPEED), theta_m, F)
        pressed = _push(m, special, p, v, theta_m, _shifted(F, i, 1.0))
        for k in range(3):
            m.slope[k, POSITION + i] = (up[k] - down[k]) / (2.0 * BY_WAY)
            m.slope[k, VELOCITY + i] = (fast[k] - base[k]) / BY_SPEED
            m.slope[k, MOTOR + i] = (high[k] - low[k]) / (2.0 * BY_ANGLE)
            m.slope[k, SPEED + i] = 0.0
            m.slope[k, FORCE + i] = pressed[k] - base[k]


@njit(cache=True, error_model="numpy", forceinline=True)
def stiffness(m, leg):
    """d tau_load / d theta_m (N m/rad) of a leg, and tau_load (N m): 0 inside the dead zone."""
    p, theta_m = m.parameters, m.x[MOTOR + leg]
    d = loaded_deflection(p, m.anchors, leg, theta_m, m.theta_l[leg])
    high = loaded_deflection(p, m.anchors, leg, theta_m + BY_ANGLE, m.theta_l[leg])
    low = loaded_deflection(p, m.anchors, leg, theta_m - BY_ANGLE, m.theta_l[leg])
    k = spring_stiffness(p, leg)
    return k * (high - low) / (2.0 * BY_ANGLE), k * d


@njit(cache=True, error_model="numpy")
def transition(m, h, E, reach, droop):
    """d x(t + h) / d x(t) into `m.phi`: exact for the drives, a series up to h^3 for the platform.

    Args:
        h: s.
        E: what is left of a difference of speed after h; reach: the way it goes in that time (s).
        droop: rad/s per N m.
    """
    phi, term, after, slope = m.phi, m.term, m.next, m.slope
    for i in range(STATES):
        for j in range(WIDE):
            phi[i, j] = 0.0
        phi[i, i] = 1.0
    for leg in range(3):
        k, _ = stiffness(m, leg)
        w, a = SPEED + leg, MOTOR + leg
        phi[w, w], phi[a, w] = E, reach
        # the speed that is aimed at is less by the droop
        phi[w, a], phi[a, a] = -(1.0 - E) * droop * k, 1.0 - (h - reach) * droop * k
        for i in range(3):
            by = droop * k * m.parameters.N * m.J[leg, i]
            phi[w, POSITION + i], phi[a, POSITION + i] = (1.0 - E) * by, (h - reach) * by
    # first derivative of (p, v); the motors are in the middle of their way
    for i in range(3):
        for j in range(WIDE):
            term[i, j] = 0.0
            term[3 + i, j] = 0.0
        term[i, VELOCITY + i] = 1.0
        for k in range(3):
            term[3 + i, POSITION + k] = slope[i, POSITION + k]
            term[3 + i, VELOCITY + k] = slope[i, VELOCITY + k]
            term[3 + i, FORCE + k] = slope[i, FORCE + k]
            term[3 + i, MOTOR + k] += 0.5 * slope[i, MOTOR + k]
        for k in range(3):
            half = 0.5 * slope[i, MOTOR + k]
            for j in range(WIDE):
                term[3 + i, j] += half * phi[MOTOR + k, j]
    share = h
    for order in range(2, 5):
        for i in range(6):
            for j in range(WIDE):
                phi[i, j] += share * term[i, j]
        share *= h / order
        for i in range(3):
            for j in range(WIDE):
                after[i, j] = term[3 + i, j]
                after[3 + i, j] = 0.0
            for k in range(6):
                by = slope[i, k]
                for j in range(WIDE):
                    after[3 + i, j] += by * term[k, j]
        for i in range(6):
            for j in range(WIDE):
                term[i, j] = after[i, j]


@njit(cache=True, error_model="numpy")
def spread(m):
    """P becomes phi P phi^T, in place."""
    P, phi, left = m.P, m.phi, m.left
    for i in range(STATES):
        for j in range(WIDE):
            left[i, j] = 0.0
        for k in range(STATES):
            by = phi[i, k]
            if by != 0.0:
                for j in range(WIDE):
                    left[i, j] += by * P[k, j]
    # the product is symmetric: its lower half, twice
    for i in range(STATES):
        for j in range(i + 1):
            total = 0.0
            for k in range(WIDE):
                total += left[i, k] * phi[j, k]
            P[i, j] = total
            P[j, i] = total


@njit(cache=True, error_model="numpy")
def wander(m, h, commanded):
    """What half a step of `h` (s) adds to P."""
    P, n = m.P, m.noises
    v = 0.5 * h * n.v * n.v
    own = m.drive.wander if commanded else n.omega
    omega = 0.5 * h * own * own
    v_x, v_y, v_z = _at(m, VELOCITY)
    touching = abs(m.x[FORCE + 2]) > TOUCHED
    own_F = n.F * n.F if touching else n.air * n.air
    across = n.mu * n.mu * (v_x * v_x + v_y * v_y) if touching else 0.0
    rate = n.touch * n.K * n.K
    F = 0.5 * h * (own_F + rate * (n.mu * n.mu * v_z * v_z + across))
    F_z = 0.5 * h * (own_F + rate * v_z * v_z)
    for i in range(3):
        P[VELOCITY + i, VELOCITY + i] += v
        P[SPEED + i, SPEED + i] += omega
        P[FORCE + i, FORCE + i] += F_z if i == 2 else F


@njit(cache=True, error_model="numpy")
def predict(m, h, special):
    """State and covariance `h` seconds later: Runge-Kutta for the platform, (6) of velocity_servo for the drives."""
    pose(m)
    commanded = not math.isnan(m.omega_ref[0] + m.omega_ref[1] + m.omega_ref[2])
    lag = m.drive.lag if commanded else math.inf
    E = math.exp(-h / lag)
    reach = lag * (1.0 - E) if commanded else h
    droop = m.drive.droop if commanded else 0.0
    linearise(m, special)
    transition(m, h, E, reach, droop)
    wander(m, h, commanded)
    spread(m)
    wander(m, h, commanded)
    p, v, start, F = _at(m, POSITION), _at(m, VELOCITY), _at(m, MOTOR), _at(m, FORCE)
    for leg in range(3):
        _, tau_load = stiffness(m, leg)
        omega = m.x[SPEED + leg]
        target = m.omega_ref[leg] - droop * tau_load if commanded else omega
        m.x[MOTOR + leg] += target * h + (omega - target) * reach
        m.x[SPEED + leg] = target + (omega - target) * E
    end, half = _at(m, MOTOR), 0.5 * h
    middle = _ahead(start, (end[0] - start[0], end[1] - start[1], end[2] - start[2]), 0.5)
    a = _push(m, special, p, v, start, F)
    v_2 = _ahead(v, a, half)
    a_2 = _push(m, special, _ahead(p, v, half), v_2, middle, F)
    v_3 = _ahead(v, a_2, half)
    a_3 = _push(m, special, _ahead(p, v_2, half), v_3, middle, F)
    v_4 = _ahead(v, a_3, h)
    a_4 = _push(m, special, _ahead(p, v_3, h), v_4, end, F)
    for i in range(3):
        m.x[POSITION + i] += h * (v[i] + 2.0 * v_2[i] + 2.0 * v_3[i] + v_4[i]) / 6.0
        m.x[VELOCITY + i] += h * (a[i] + 2.0 * a_2[i] + 2.0 * a_3[i] + a_4[i]) / 6.0


@njit(cache=True, error_model="numpy", forceinline=True)
def measured(m, sensor, count):
    """The angle (rad) that a count of `sensor`, 0 to 5, stands for."""
    if sensor < 3:
        return angle(count, m.belief.motor_counts, m.belief.motor_zero[sensor])
    return angle(count, m.belief.joint_counts, m.belief.joint_zero[sensor - 3])


@njit(cache=True, error_model="numpy")
def speed_variance(m, sensor):
    """Of the speed of a shaft, (rad/s)^2."""
    P, leg = m.P, sensor % 3
    if sensor < 3:
        return P[SPEED + leg, SPEED + leg]
    total = 0.0
    for i in range(3):
        for k in range(3):
            total += m.J[leg, i] * P[VELOCITY + i, VELOCITY + k] * m.J[leg, k]
    return total


@njit(cache=True, error_model="numpy")
def take(m, sensor, count, h, expected):
    """What a count says, into `m.nu` and `m.R` (rad, rad^2); NaN if it says nothing new.

    The angle was in the cell of the count before, and has moved as the filter expects; it is in the cell of this one.
    Where both overlap it lies. A count that stays is in the same cell: nothing new, unless noise dithers it.
    """
    motor = sensor < 3
    turn = 2.0 * math.pi / (m.belief.motor_counts if motor else m.belief.joint_counts)
    noise = m.sensors.motor_noise if motor else m.sensors.joint_noise
    last, m.nu[sensor] = m.counts[sensor], math.nan
    if math.isnan(count):
        m.kept[sensor] += h
        return
    if count == last:
        m.kept[sensor] += h
    else:
        m.counts[sensor], m.still = count, 0.0
    wide, middle = 1.0, 0.0
    if noise < DITHERED * turn:
        if count == last:
            if m.kept[sensor] < REPEATED:
                return
        elif noise >= EDGE * turn:
            # near an edge: half a count off
            wide = JUST_CHANGED
        else:
            # both cells, seen from the middle of this one
            way = (expected - m.before[sensor]) / turn - (count - last)
            low, high = max(-0.5, way - 0.5), min(0.5, way + 0.5)
            if high - low > -1.0:
                unsure = h * h * speed_variance(m, sensor) / (turn * turn) + EDGE * EDGE
                wide, middle = min(1.0, math.sqrt((high - low) ** 2 + 12.0 * unsure)), 0.5 * (low + high)
    m.kept[sensor] = 0.0
    m.nu[sensor] = measured(m, sensor, count) + middle * turn - expected
    m.R[sensor] = turn * turn * wide * wide / 12.0 + noise * noise


@njit(cache=True, error_model="numpy")
def correct(m, h, y):
    """Take the counts in, one after the other; the squared residuals by their variances are summed into `y.NIS`."""
    P, PH, total = m.P, m.PH, m.total
    for i in range(STATES):
        total[i] = 0.0
    square, used = 0.0, 0
    for sensor in range(COUNTS):
        nu, leg = m.nu[sensor], sensor % 3
        if math.isnan(nu):
            m.refused[sensor] += h if m.refused[sensor] > 0.0 else 0.0
            continue
        used += 1
        if sensor < 3:
            for j in range(WIDE):
                PH[j] = P[MOTOR + leg, j]
            S = PH[MOTOR + leg]
            nu -= total[MOTOR + leg]
        else:
            a, b, c = m.J[leg, 0], m.J[leg, 1], m.J[leg, 2]
            for j in range(WIDE):
                PH[j] = a * P[0, j] + b * P[1, j] + c * P[2, j]
            S = a * PH[0] + b * PH[1] + c * PH[2]
            nu -= a * total[0] + b * total[1] + c * total[2]
        S += m.R[sensor]
        square += nu * nu / S
        if nu * nu > GARBLED * S:
            m.refused[sensor] += h
            continue
        m.refused[sensor] = 0.0
        for i in range(STATES):
            gain = PH[i] / S
            total[i] += gain * nu
            for j in range(WIDE):
                P[i, j] -= gain * PH[j]
    for i in range(STATES):
        m.x[i] += total[i]
    y.used = used
    y.NIS = square if used else math.nan


@njit(cache=True, error_model="numpy")
def begin(m, u):
    """Start where the counts have the robot, at rest, with the force of statics; False where they fit no pose."""
    for leg in range(3):
        m.theta_l[leg] = measured(m, 3 + leg, u.count_l[leg])
        m.x[MOTOR + leg] = measured(m, leg, u.count_m[leg])
        m.x[VELOCITY + leg] = m.x[SPEED + leg] = m.x[FORCE + leg] = 0.0
    m.x[0], m.x[1], m.x[2] = platform_position(m.parameters, m.theta_l[0], m.theta_l[1], m.theta_l[2])
    if math.isnan(m.x[0] + m.x[6] + m.x[7] + m.x[8]):
        return False
    for i in range(STATES):
        for j in range(WIDE):
            m.P[i, j] = 0.0
    for group in range(5):
        for i in range(3):
            m.P[3 * group + i, 3 * group + i] = FIRST[group] * FIRST[group]
    pose(m)
    special = has_effects(m.parameters)
    linearise(m, special)
    a = _push(m, special, _at(m, POSITION), _at(m, VELOCITY), _at(m, MOTOR), _at(m, FORCE))
    # the force that would take this acceleration away: slope F = -a
    F = solved(m.slope, a)
    for i in range(3):
        m.x[FORCE + i] = -F[i]
    for i in range(COUNTS):
        m.counts[i] = u.count_m[i] if i < 3 else u.count_l[i - 3]
        m.kept[i] = m.refused[i] = 0.0
    m.still = 0.0
    return True


@njit(cache=True, error_model="numpy")
def solved(slope, a):
    """F of slope_F F = a, a triple."""
    m11, m12, m13 = slope[0, FORCE], slope[0, FORCE + 1], slope[0, FORCE + 2]
    m21, m22, m23 = slope[1, FORCE], slope[1, FORCE + 1], slope[1, FORCE + 2]
    m31, m32, m33 = slope[2, FORCE], slope[2, FORCE + 1], slope[2, FORCE + 2]
    n_1, n_2, n_3 = m22 * m33 - m23 * m32, m13 * m32 - m12 * m33, m12 * m23 - m13 * m22
    D = m11 * n_1 + m21 * n_2 + m31 * n_3
    x = (a[0] * n_1 + a[1] * n_2 + a[2] * n_3) / D
    b = a[0] * (m23 * m31 - m21 * m33) + a[1] * (m11 * m33 - m13 * m31) + a[2] * (m13 * m21 - m11 * m23)
    c = a[0] * (m21 * m32 - m22 * m31) + a[1] * (m12 * m31 - m11 * m32) + a[2] * (m11 * m22 - m12 * m21)
    return x, b / D, c / D


@njit(cache=True, error_model="numpy")
def tell(m, y):
    """The state and its deviations into the outputs."""
    for i in range(3):
        y.p_B[i], y.v_B[i] = m.x[POSITION + i], m.x[VELOCITY + i]
        y.theta_m[i], y.omega_m[i], y.F_ee_B[i] = m.x[MOTOR + i], m.x[SPEED + i], m.x[FORCE + i]
    for i in range(STATES):
        y.deviation[i] = math.sqrt(m.P[i, i])


@njit(cache=True, error_model="numpy")
def residuals(m, h, u, y):
    """What came less what was expected, before any of it is taken in."""
    pose(m)
    m.still += h
    for sensor in range(COUNTS):
        leg = sensor % 3
        count = u.count_m[leg] if sensor < 3 else u.count_l[leg]
        expected = m.x[MOTOR + leg] if sensor < 3 else m.theta_l[leg]
        take(m, sensor, count, h, expected)
        if sensor < 3:
            y.residual_m[leg] = measured(m, sensor, count) - expected
        else:
            y.residual_l[leg] = measured(m, sensor, count) - expected
    y.residual_F = u.F_z + m.x[FORCE + 2]
    for leg in range(3):
        _, tau_load = stiffness(m, leg)
        target = m.omega_ref[leg] - m.drive.droop * tau_load
        alpha = (target - m.x[SPEED + leg]) / m.drive.lag
        y.residual_tau[leg] = u.tau_motor[leg] - tau_load - m.drive.inertia * alpha


@njit(cache=True, error_model="numpy")
def forget(y):
    for i in range(3):
        y.residual_m[i] = y.residual_l[i] = y.residual_tau[i] = math.nan
    y.NIS, y.residual_F, y.used = math.nan, math.nan, 0


@step_function(MEMORY, INPUTS, OUTPUTS)
def step(m, t, h, u, y):
    y.started = m.on != RUNNING or not h <= LONGEST_GAP
    if y.started:
        forget(y)
    else:
        for leg in range(3):
            m.before[leg], m.before[3 + leg] = m.x[MOTOR + leg], m.theta_l[leg]
        special, steps = has_effects(m.parameters), math.ceil(h / LONGEST_STEP - 1e-6)
        for _ in range(steps):
            predict(m, h / steps, special)
        if steps:
            residuals(m, h, u, y)
            correct(m, h, y)
            pose(m)
        # what no pose goes with, or counts do not go with, cannot be corrected any more
        y.started = math.isnan(m.theta_l[0] + m.theta_l[1] + m.theta_l[2] + m.x[FORCE])
        for sensor in range(COUNTS):
            y.started = y.started or m.refused[sensor] > LONGEST_GAP
    if y.started:
        found = begin(m, u)
        if not (found or m.on):
            return NO_POSE
        m.on = RUNNING if found else LOST
        for i in range(STATES):
            m.x[i] = m.x[i] if found else math.nan
    for i in range(3):
        m.omega_ref[i] = u.omega_ref[i]
    y.moves = m.still < MOVED
    tell(m, y)
    return 0


class Shadow(NativeComponent):
    """Sampled component: counts and commands of a robot in, its state out; a step is one sample.

    The length of a step is the time since the sample before, by the robot's stamps; of the first one it may be
    anything.

    Args:
        parameters: of the plant; what its contact is plays no role, and dry friction of joints and springs neither.
        believed: what turns counts into angles.
        sensors, drive, noises: see there.
    """

    def __init__(
        self,
        parameters: PlantParameters,
        believed: Belief,
        sensors: Sensors,
        drive: DriveModel,
        noises: Noises = Noises(),  # noqa: B008, it is a tuple
    ):
        known = parameters._replace(joint_friction=0.0, spring_hysteresis=0.0)
        memory = memory_of(
            MEMORY, parameters=tuple(known), belief=tuple(believed), sensors=tuple(sensors), drive=tuple(drive),
            noises=tuple(noises), anchors=UNTOUCHED,
        )  # fmt: skip
        super().__init__("shadow", INPUTS, OUTPUTS, True, step, memory)
        self.finite = False

    def explain(self, status: int) -> str:
        return "found no pose that fits the first counts"
