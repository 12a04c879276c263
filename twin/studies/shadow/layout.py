"""What the filter of a running robot keeps in memory, what it takes and what it says; and what it believes."""

import math
from typing import NamedTuple

from twin.kernel.cosim.port import Port, record, record_of, states
from twin.robot.controller.controller import BELIEF_RECORD
from twin.robot.plant.dynamics import PARAMETERS_RECORD
from twin.robot.plant.joints import ANCHOR_SIZE

STATES = 15
MATRIX_WIDTH = 16
"""Columns of a matrix: whole registers of four."""
POSITION, VELOCITY, MOTOR, SPEED, FORCE = 0, 3, 6, 9, 12
"""Where each triple begins in the state."""
ENCODER_COUNT = 6
LONGEST_STEP = 2.5e-3
"""s. The springs' fastest swing, 120 rad/s, turns by 0.3 rad in it; see docs/physics.md."""
DITHER_NOISE = 0.5
"""Deviation of an encoder's noise, in counts, from which on rounding is white: each sample is a new measurement."""
TOUCH_FORCE = 0.3
"""N. Pressing less than that the robot is in free air, where a force does not wander."""
HEADING_TIME, HEADING_SPEED = 0.1, 5e-3
"""s, m/s. The way across a surface is known by a mean over so long, where it is faster than that."""
EDGE_WIDTH = 0.1
"""Counts. Where a count changes is not known better than that."""
JUST_CHANGED = math.sqrt(3.0)
"""Counts. Evenly spread over so much, an error has a deviation of half a count."""
REPEAT_TIME = 0.004
"""s. A count that stays is taken in again after so long; until then it says nothing new."""
MAX_SQUARED_INNOVATION = 1e4
"""Squared deviations. A count so far off shows in the residual; it is not taken in before it stays for
`LONGEST_GAP`."""
STANDSTILL_TIME = 0.1
"""s. If no count has changed for so long the robot stands still."""
INITIAL_DEVIATIONS = (1e-3, 0.05, 1e-3, 0.5, 1.0)
"""Deviations of position, velocity, motor angle, its speed and force in the beginning, SI."""
NO_POSE = 2
STATUS_RUNNING, STATUS_LOST = 1, 2
"""What the filter is doing: following, or waiting for counts that fit a pose again; 0: not begun."""
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
    Port("NIS", 1, "1", "squared residuals of the counts by their variances; NaN: none said anything new"),
    Port("used", 1, "1", "how many counts said anything new", "int"),
    Port("moves", 1, "1", "whether a count has changed within the last 0.1 s", "bool"),
    Port("started", 1, "1", "whether the filter has started anew with this sample", "bool"),
)
MATRIX_TYPE = ("f8", (STATES, MATRIX_WIDTH))


class ShadowDrive(NamedTuple):
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
        air: the same in free air.
        unsure: share of the stiffness of what is touched that is not known.
        mu: share of that which changes a force sideways.
        touch: for how long (s) such a change goes on in one sense.
        omega: intensity of the wander of a motor's acceleration whose command is not known (rad/s2/sqrt(Hz)).
    """

    v: float = 1e-3
    F: float = 0.4
    air: float = 0.05
    unsure: float = 0.5
    mu: float = 0.3
    touch: float = 2e-3
    omega: float = 5.0


class Sensors(NamedTuple):
    """Deviation (rad) of the encoders' white noise, besides their rounding."""

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
