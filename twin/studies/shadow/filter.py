"""Extended Kalman filter for the state of a running robot from its encoder counts, one compiled step per sample.

x = (p_B, v_B, theta_m, omega_m, F_ee_B), three of each. The platform moves as the plant does (P5). The contact force is
a random walk that grows with the speed into the surface and turns with the direction across it by w; the drives follow
their commands with a lag and droop under load (P12):

    dp/dt = v,  dv/dt = a(p, v, theta_m, F) + n_v,  d theta_m/dt = omega,
    d omega/dt = (omega_ref - droop tau_load - omega)/T_m + n_omega,  dF/dt = (-w F_y, w F_x, K v_z) + n_F.

The counts measure theta_m and theta_l(p). docs/identification_method.md has the derivation, the source of the
noises, and the limits of six counts. Motor torque and measured force are compared with the estimate but not used in
it, so that they can contradict it.
"""

import math

from twin.kernel.compiled.function import njit
from twin.kernel.cosim.component import NativeComponent, step_function
from twin.kernel.cosim.port import memory_of
from twin.robot.controller.controller import Belief, angle
from twin.robot.mechanism.kinematics import platform_position
from twin.robot.plant.dynamics import INITIAL_ANCHORS, LONGEST_GAP, PlantParameters, has_effects
from twin.studies.replay.sample_columns import INPUTS
from twin.studies.shadow.layout import (
    DITHER_NOISE,
    EDGE_WIDTH,
    ENCODER_COUNT,
    FORCE,
    INITIAL_DEVIATIONS,
    JUST_CHANGED,
    LONGEST_STEP,
    MATRIX_WIDTH,
    MAX_SQUARED_INNOVATION,
    MEMORY,
    MOTOR,
    NO_POSE,
    OUTPUTS,
    POSITION,
    REPEAT_TIME,
    SPEED,
    STANDSTILL_TIME,
    STATES,
    STATUS_LOST,
    STATUS_RUNNING,
    VELOCITY,
    Noises,
    Sensors,
    ShadowDrive,
)
from twin.studies.shadow.prediction import linearise, pose, predict, push, stiffness, triple


@njit(cache=True, error_model="numpy", forceinline=True)
def measured_angle(m, sensor, count):
    """Convert an encoder count of `sensor`, 0 to 5, to an angle (rad)."""
    if sensor < 3:
        return angle(count, m.belief.motor_counts, m.belief.motor_zero[sensor])
    return angle(count, m.belief.joint_counts, m.belief.joint_zero[sensor - 3])


@njit(cache=True, error_model="numpy")
def speed_variance(m, sensor):
    """Return the filter's variance of the speed of the shaft at a sensor ((rad/s)^2)."""
    P, leg = m.P, sensor % 3
    if sensor < 3:
        return P[SPEED + leg, SPEED + leg]
    total = 0.0
    for i in range(3):
        for k in range(3):
            total += m.J[leg, i] * P[VELOCITY + i, VELOCITY + k] * m.J[leg, k]
    return total


@njit(cache=True, error_model="numpy")
def innovation(m, sensor, count, h, expected):
    """Compute the innovation of an encoder count and its variance into `m.nu` and `m.R` (rad, rad^2); NaN for a count
    without news.

    The angle was in the cell of the previous count, has moved as the filter expects, and is in the cell of this count,
    hence in the overlap of both. A repeated count has the same cell, hence no news unless noise dithers it.
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
    if noise < DITHER_NOISE * turn:
        if count == last:
            if m.kept[sensor] < REPEAT_TIME:
                return
        elif noise >= EDGE_WIDTH * turn:
            # near an edge: half a count off
            wide = JUST_CHANGED
        else:
            # both cells relative to the middle of the present one
            way = (expected - m.before[sensor]) / turn - (count - last)
            low, high = max(-0.5, way - 0.5), min(0.5, way + 0.5)
            if high - low > -1.0:
                unsure = h * h * speed_variance(m, sensor) / (turn * turn) + EDGE_WIDTH * EDGE_WIDTH
                wide, middle = min(1.0, math.sqrt((high - low) ** 2 + 12.0 * unsure)), 0.5 * (low + high)
    m.kept[sensor] = 0.0
    m.nu[sensor] = measured_angle(m, sensor, count) + middle * turn - expected
    m.R[sensor] = turn * turn * wide * wide / 12.0 + noise * noise


@njit(cache=True, error_model="numpy")
def correct(m, h, y):
    """Correct the state with the counts, one after the other; sum squared residuals by their variances into `y.NIS`."""
    P, PH, total = m.P, m.PH, m.total
    for i in range(STATES):
        total[i] = 0.0
    square, used = 0.0, 0
    for sensor in range(ENCODER_COUNT):
        nu, leg = m.nu[sensor], sensor % 3
        if math.isnan(nu):
            m.refused[sensor] += h if m.refused[sensor] > 0.0 else 0.0
            continue
        used += 1
        if sensor < 3:
            for j in range(MATRIX_WIDTH):
                PH[j] = P[MOTOR + leg, j]
            S = PH[MOTOR + leg]
            nu -= total[MOTOR + leg]
        else:
            a, b, c = m.J[leg, 0], m.J[leg, 1], m.J[leg, 2]
            for j in range(MATRIX_WIDTH):
                PH[j] = a * P[0, j] + b * P[1, j] + c * P[2, j]
            S = a * PH[0] + b * PH[1] + c * PH[2]
            nu -= a * total[0] + b * total[1] + c * total[2]
        S += m.R[sensor]
        square += nu * nu / S
        if nu * nu > MAX_SQUARED_INNOVATION * S:
            m.refused[sensor] += h
            continue
        m.refused[sensor] = 0.0
        for i in range(STATES):
            gain = PH[i] / S
            total[i] += gain * nu
            for j in range(MATRIX_WIDTH):
                P[i, j] -= gain * PH[j]
    for i in range(STATES):
        m.x[i] += total[i]
    y.used = used
    y.NIS = square if used else math.nan


@njit(cache=True, error_model="numpy")
def begin(m, u):
    """Initialise the filter from the counts, at rest, with the force of statics; return False if they fit no pose."""
    for leg in range(3):
        m.theta_l[leg] = measured_angle(m, 3 + leg, u.count_l[leg])
        m.x[MOTOR + leg] = measured_angle(m, leg, u.count_m[leg])
        m.x[VELOCITY + leg] = m.x[SPEED + leg] = m.x[FORCE + leg] = 0.0
    m.x[0], m.x[1], m.x[2] = platform_position(m.parameters, m.theta_l[0], m.theta_l[1], m.theta_l[2])
    if math.isnan(m.x[0] + m.x[6] + m.x[7] + m.x[8]):
        return False
    for i in range(STATES):
        for j in range(MATRIX_WIDTH):
            m.P[i, j] = 0.0
    for group in range(5):
        for i in range(3):
            m.P[3 * group + i, 3 * group + i] = INITIAL_DEVIATIONS[group] * INITIAL_DEVIATIONS[group]
    pose(m)
    special = has_effects(m.parameters)
    linearise(m, special)
    a = push(m, special, triple(m, POSITION), triple(m, VELOCITY), triple(m, MOTOR), triple(m, FORCE))
    # the force that cancels this acceleration: slope F = -a
    F = solve_force(m.slope, a)
    for i in range(3):
        m.x[FORCE + i] = -F[i]
    for i in range(ENCODER_COUNT):
        m.counts[i] = u.count_m[i] if i < 3 else u.count_l[i - 3]
        m.kept[i] = m.refused[i] = 0.0
    m.still = m.slow[0] = m.slow[1] = 0.0
    return True


@njit(cache=True, error_model="numpy")
def solve_force(slope, a):
    """Solve the linear equation slope_F F = a for the force F (3 components)."""
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
def write_outputs(m, y):
    for i in range(3):
        y.p_B[i], y.v_B[i] = m.x[POSITION + i], m.x[VELOCITY + i]
        y.theta_m[i], y.omega_m[i], y.F_ee_B[i] = m.x[MOTOR + i], m.x[SPEED + i], m.x[FORCE + i]
    for i in range(STATES):
        y.deviation[i] = math.sqrt(m.P[i, i])


@njit(cache=True, error_model="numpy")
def residuals(m, h, u, y):
    pose(m)
    m.still += h
    for sensor in range(ENCODER_COUNT):
        leg = sensor % 3
        count = u.count_m[leg] if sensor < 3 else u.count_l[leg]
        expected = m.x[MOTOR + leg] if sensor < 3 else m.theta_l[leg]
        innovation(m, sensor, count, h, expected)
        if sensor < 3:
            y.residual_m[leg] = measured_angle(m, sensor, count) - expected
        else:
            y.residual_l[leg] = measured_angle(m, sensor, count) - expected
    y.residual_F = u.F_z + m.x[FORCE + 2]
    for leg in range(3):
        _, tau_load = stiffness(m, leg)
        target = m.omega_ref[leg] - m.drive.droop * tau_load
        # without a known command the expected acceleration is 0
        known = m.drive.lag > 0.0 and not math.isnan(target)
        alpha = (target - m.x[SPEED + leg]) / m.drive.lag if known else 0.0
        y.residual_tau[leg] = u.tau_motor[leg] - tau_load - m.drive.inertia * alpha


@njit(cache=True, error_model="numpy")
def clear_residuals(y):
    for i in range(3):
        y.residual_m[i] = y.residual_l[i] = y.residual_tau[i] = math.nan
    y.NIS, y.residual_F, y.used = math.nan, math.nan, 0


@step_function(MEMORY, INPUTS, OUTPUTS)
def step(m, t, h, u, y):
    y.started = m.on != STATUS_RUNNING or not h <= LONGEST_GAP
    if y.started:
        clear_residuals(y)
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
        # a state without a pose, or far from the counts, cannot be corrected
        y.started = math.isnan(m.theta_l[0] + m.theta_l[1] + m.theta_l[2] + m.x[FORCE])
        for sensor in range(ENCODER_COUNT):
            y.started = y.started or m.refused[sensor] > LONGEST_GAP
    if y.started:
        found = begin(m, u)
        if not (found or m.on):
            return NO_POSE
        m.on = STATUS_RUNNING if found else STATUS_LOST
        for i in range(STATES):
            m.x[i] = m.x[i] if found else math.nan
    for i in range(3):
        m.omega_ref[i] = u.omega_ref[i]
    y.moves = m.still < STANDSTILL_TIME
    write_outputs(m, y)
    return 0


def _without_dry_friction(parameters: PlantParameters) -> tuple[object, ...]:
    """Return the plant's parameters without dry friction; counts of a robot at rest do not determine its direction."""
    return tuple(parameters._replace(joint_friction=0.0, spring_hysteresis=0.0))


class Shadow(NativeComponent):
    """Extended Kalman filter, a sampled component: counts and commands of a robot in, its state out, one step per
    sample.

    The step length is the time since the previous sample by the robot's stamps; the first step ignores it.

    Args:
        parameters: parameters of the plant; of the contact only the stiffness is used, and no dry friction.
        believed: belief that converts counts to angles.
    """

    def __init__(self, parameters: PlantParameters, believed: Belief, sensors: Sensors, drive: ShadowDrive):
        memory = memory_of(
            MEMORY, parameters=_without_dry_friction(parameters), belief=tuple(believed), sensors=tuple(sensors),
            drive=tuple(drive), noises=tuple(Noises()), anchors=INITIAL_ANCHORS,
        )  # fmt: skip
        super().__init__("shadow", INPUTS, OUTPUTS, True, step, memory)
        self.finite = False

    def accept(self, parameters: PlantParameters) -> None:
        self.memory["parameters"][0] = _without_dry_friction(parameters)

    def explain(self, status: int) -> str:
        return "found no pose that fits the first counts"
