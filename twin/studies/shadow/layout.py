"""Memory layout, outputs and parameters of the filter."""

import math
from typing import NamedTuple

from twin.kernel.cosim.port import Port, record, record_of, states
from twin.robot.controller.controller import BELIEF_RECORD
from twin.robot.plant.dynamics import PARAMETERS_RECORD
from twin.robot.plant.joints import ANCHOR_SIZE

STATES = 15
MATRIX_WIDTH = 16
"""Number of columns of a matrix: whole registers of four."""
POSITION, VELOCITY, MOTOR, SPEED, FORCE = 0, 3, 6, 9, 12
"""First index of each triple in the state."""
ENCODER_COUNT = 6
LONGEST_STEP = 2.5e-3
"""Maximum step (s): the springs' fastest swing, 120 rad/s, advances by 0.3 rad in it; see docs/physics.md."""
DITHER_NOISE = 0.5
"""Minimum encoder noise (standard deviation, counts) for white rounding errors: each sample is a new measurement."""
TOUCH_FORCE = 0.3
"""Minimum pressing force in contact (N); below it the force does not wander."""
HEADING_TIME, HEADING_SPEED = 0.1, 5e-3
"""Averaging time of the direction across a surface (s), and the speed above which the direction is defined (m/s)."""
EDGE_WIDTH = 0.1
"""Uncertainty of the angle of a count's edge (counts)."""
JUST_CHANGED = math.sqrt(3.0)
"""Width (counts) of a uniform distribution whose standard deviation is half a count."""
REPEAT_TIME = 0.004
"""Time (s) after which a repeated count is used again."""
MAX_SQUARED_INNOVATION = 1e4
"""Maximum squared innovation by its variance; a count beyond it is used only after `LONGEST_GAP`."""
STANDSTILL_TIME = 0.1
"""Time without a changed count (s) after which the robot is at rest."""
INITIAL_DEVIATIONS = (1e-3, 0.05, 1e-3, 0.5, 1.0)
"""Initial standard deviations of position, velocity, motor angle, motor speed and force, SI."""
NO_POSE = 2
STATUS_RUNNING, STATUS_LOST = 1, 2
"""Status of the filter: running, or waiting for counts that fit a pose; 0 before the start."""
OUTPUTS = (
    Port("p_B", 3, "m", "estimated platform position, base frame B"),
    Port("v_B", 3, "m/s", "estimated platform velocity, base frame B"),
    Port("theta_m", 3, "rad", "estimated motor angles"),
    Port("omega_m", 3, "rad/s", "estimated motor speeds"),
    Port("F_ee_B", 3, "N", "estimated force by the robot on the environment, base frame B"),
    Port("deviation", STATES, "SI", "standard deviations of these"),
    Port("residual_m", 3, "rad", "motor angles by counts less their prediction; NaN without a count"),
    Port("residual_l", 3, "rad", "joint angles by counts less their prediction; NaN without a count"),
    Port("residual_F", 1, "N", "measured pressing force less its prediction; NaN without a measurement"),
    Port("residual_tau", 3, "N m", "motor torques less their prediction; NaN without a measurement"),
    Port("NIS", 1, "1", "squared residuals of the counts by their variances; NaN without a new count"),
    Port("used", 1, "1", "number of new counts", "int"),
    Port("moves", 1, "1", "whether a count has changed within the last 0.1 s", "bool"),
    Port("started", 1, "1", "whether the filter restarted with this sample", "bool"),
)
MATRIX_TYPE = ("f8", (STATES, MATRIX_WIDTH))


class ShadowDrive(NamedTuple):
    """Drive model of the filter, SI: lag, droop and inertia of a motor.

    Attributes:
        lag: T_m (s); 0 if the speed is the commanded one.
        droop: speed loss per load (rad/s per N m).
        inertia: inertia of a rotor (kg m2), for the motor's torque.
        wander: intensity of the unmodelled acceleration (rad/s2/sqrt(Hz)).
    """

    lag: float
    droop: float
    inertia: float
    wander: float


class Noises(NamedTuple):
    """Process noise intensities of the filter, SI; see docs/identification_method.md.

    Attributes:
        v: intensity of unmodelled platform acceleration (m/s2/sqrt(Hz)).
        F: intensity of the force's random walk on a platform at rest in contact (N/sqrt(s)).
        air: intensity of the force's random walk in free air (N/sqrt(s)).
        unsure: relative uncertainty of the surface's stiffness.
        mu: lateral share of a force change.
        touch: correlation time of a force change (s).
        omega: intensity of a motor's acceleration without a known command (rad/s2/sqrt(Hz)).
    """

    v: float = 1e-3
    F: float = 0.4
    air: float = 0.05
    unsure: float = 0.5
    mu: float = 0.3
    touch: float = 2e-3
    omega: float = 5.0


class Sensors(NamedTuple):
    """Encoder noise model of the filter: standard deviation (rad) of white noise, without rounding."""

    motor_noise: float
    joint_noise: float


MEMORY = record(
    parameters=PARAMETERS_RECORD,
    belief=BELIEF_RECORD,
    drive=record_of(ShadowDrive),
    noises=record_of(Noises),
    sensors=record_of(Sensors),
    **states(
        x=("f8", (STATES,)),
        P=MATRIX_TYPE,
        anchors=("f8", (3, ANCHOR_SIZE)),
        omega_ref="3f8",
        slow="2f8",
        counts=("f8", (ENCODER_COUNT,)),
        kept=("f8", (ENCODER_COUNT,)),
        still="f8",
        refused=("f8", (ENCODER_COUNT,)),
        on="i8",
    ),
    # of one step
    slope=("f8", (3, STATES)),
    J=("f8", (3, 3)),
    theta_l="3f8",
    phi=MATRIX_TYPE,
    left=MATRIX_TYPE,
    term=("f8", (6, MATRIX_WIDTH)),
    next=("f8", (6, MATRIX_WIDTH)),
    before=("f8", (ENCODER_COUNT,)),
    nu=("f8", (ENCODER_COUNT,)),
    R=("f8", (ENCODER_COUNT,)),
    PH=("f8", (MATRIX_WIDTH,)),
    total=("f8", (STATES,)),
)
