"""Reasons of a trip: codes, and their error messages."""

import math
from enum import IntEnum
from typing import NamedTuple

_DEG_PER_RAD = math.degrees(1.0)


class Reason(IntEnum):
    """Reasons of a monitor's trip, in order of precedence within one evaluation.

    Reasons that make the measurement itself doubtful precede limits of measured quantities.
    """

    NONE = 0
    INVALID_SAMPLE = 1
    STALE = 2
    JUMP = 3
    NO_POSE = 4
    DEFLECTION = 5
    FROZEN_MOTOR = 6
    FROZEN_JOINT = 7
    FORCE = 8
    FORCE_RATE = 9
    PENETRATION = 10
    SPEED = 11
    RADIUS = 12
    TOO_LOW = 13
    TOO_HIGH = 14
    CONTACT_TIME = 15
    INVALID_COMMAND = 16
    SATURATION = 17
    FOLLOW = 18
    HIDDEN_FORCE = 19
    SILENT = 20


class ReasonText(NamedTuple):
    """Error message of a trip reason: cause, compared quantity, displayed unit, and number of these units per SI unit.

    `sentence` has `{joint}` where one joint caused the trip.
    """

    sentence: str
    quantity: str
    unit: str
    per_si: float


REASON_TEXTS = {
    Reason.INVALID_SAMPLE: ReasonText("the encoder message holds NaN or infinity", "invalid values", "", 1.0),
    Reason.STALE: ReasonText("the encoder messages do not match the time", "off by", "ms", 1e3),
    Reason.JUMP: ReasonText(
        "joint {joint}: an encoder jumped further than drive and joint can move", "motor-side speed", "rad/s", 1.0
    ),
    Reason.NO_POSE: ReasonText("the joint angles fit no pose of the robot", "unfit samples", "", 1.0),
    Reason.DEFLECTION: ReasonText(
        "joint {joint}: the spring is deflected too far, or an encoder is wrong", "deflection", "deg", _DEG_PER_RAD
    ),
    Reason.FROZEN_MOTOR: ReasonText(
        "joint {joint}: the motor encoder stands still although the motor is commanded to move", "for", "ms", 1e3
    ),
    Reason.FROZEN_JOINT: ReasonText(
        "joint {joint}: the joint encoder stands still although the motor moves", "motor travel", "deg", _DEG_PER_RAD
    ),
    Reason.FORCE: ReasonText("the robot presses too hard", "|F_ee_B|", "N", 1.0),
    Reason.FORCE_RATE: ReasonText("the force grows too fast", "rate", "N/s", 1.0),
    Reason.PENETRATION: ReasonText("the robot is too far below its first contact", "depth", "mm", 1e3),
    Reason.SPEED: ReasonText("the platform moves too fast", "speed", "mm/s", 1e3),
    Reason.RADIUS: ReasonText("the platform left the workspace sideways", "distance from the axis", "mm", 1e3),
    Reason.TOO_LOW: ReasonText("the platform left the workspace downwards", "z", "mm", 1e3),
    Reason.TOO_HIGH: ReasonText("the platform left the workspace upwards", "z", "mm", 1e3),
    Reason.CONTACT_TIME: ReasonText("the robot has pressed too long without a pause", "contact time", "s", 1.0),
    Reason.INVALID_COMMAND: ReasonText("the controller commands NaN or infinity", "invalid values", "", 1.0),
    Reason.SATURATION: ReasonText("joint {joint}: the command has stayed at its limit", "for", "ms", 1e3),
    Reason.FOLLOW: ReasonText("joint {joint}: the motor does not follow its command", "for", "ms", 1e3),
    Reason.HIDDEN_FORCE: ReasonText(
        "the motors yield to more force than the encoders show: an encoder is wrong", "for", "ms", 1e3
    ),
    Reason.SILENT: ReasonText("the remote controller sends no commands", "for", "ms", 1e3),
}


class Trip(NamedTuple):
    """Latched trip of the safety monitor: the evaluation's tick, the first reached limit, and the compared values, SI.

    `joint` is 1, 2 or 3 where one joint caused the trip, else 0.
    """

    tick: int
    reason: Reason
    value: float
    limit: float
    joint: int


def trip_message(trip: Trip) -> str:
    """Format the error message of a trip: joint, cause, the measured value and its limit."""
    meaning = REASON_TEXTS[trip.reason]
    unit = f" {meaning.unit}" if meaning.unit else ""
    value, limit = meaning.per_si * trip.value, meaning.per_si * trip.limit
    sentence = meaning.sentence.format(joint=trip.joint)
    return f"safety monitor: {sentence}: {meaning.quantity} {value:.4g}{unit}, limit {limit:.4g}{unit}"


REASON_COUNT = len(Reason)
"""Number of reasons, NONE among them."""
