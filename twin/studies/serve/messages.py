"""ROS 2 messages of a served robot, as CDR bytes: joint states, wrench, clock and motor commands."""

import math
import struct
from collections.abc import Callable, Sequence
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import ArrayLike, NDArray

from twin.kernel.recording.sources.ros_types import TYPE_STORE

JOINT_STATE, WRENCH, CLOCK = "sensor_msgs/msg/JointState", "geometry_msgs/msg/WrenchStamped", "rosgraph_msgs/msg/Clock"
SPEED_ARRAY = "std_msgs/msg/Float64MultiArray"
BASE_FRAME = "base"
"""Frame of joint states and wrench: the robot's base, z up."""
MOTOR_COUNT = 3
MAX_NAMES = 6
"""Maximum number of joint names in an error message."""
NS_PER_SECOND = 10**9
STAMP, STAMP_OFFSET = struct.Struct("<iI"), 4
"""Encoding of a stamp in CDR, and its offset in messages that begin with it: behind the encapsulation header."""

_Time, _Header = TYPE_STORE.types["builtin_interfaces/msg/Time"], TYPE_STORE.types["std_msgs/msg/Header"]
_JointState, _Clock = TYPE_STORE.types[JOINT_STATE], TYPE_STORE.types[CLOCK]
_Vector3, _Wrench = TYPE_STORE.types["geometry_msgs/msg/Vector3"], TYPE_STORE.types["geometry_msgs/msg/Wrench"]
_WrenchStamped = TYPE_STORE.types[WRENCH]
_EMPTY = np.empty(0)


class MotorCommand(NamedTuple):
    """A received command.

    Attributes:
        stamp: `header.stamp` (ns); None for a type without a stamp.
        speeds: motor speeds (rad/s) in the order of the motors, (3,); NaN for an invalid command.
        mistake: error message if the message is no command of this robot; "" for a command, also with NaN.
        obeyed: whether its publisher is the obeyed one.
    """

    stamp: int | None
    speeds: NDArray[np.float64]
    mistake: str = ""
    obeyed: bool = True


def joint_state(
    stamp: int, names: Sequence[str], position: ArrayLike = (), velocity: ArrayLike = (), effort: ArrayLike = ()
) -> bytes:
    """Encode a JointState stamped `stamp` (ns), with positions (rad), speeds (rad/s) and torques (N m)."""
    arrays = (np.asarray(one, dtype=np.float64) for one in (position, velocity, effort))
    return _serialize(_JointState(_header(stamp), list(names), *arrays), JOINT_STATE)


def wrench(stamp: int, F_z: float) -> bytes:
    """Encode the force (N) of the robot on the scale as a WrenchStamped; `F_z` presses down, against the frame's z."""
    force, torque = _Vector3(0.0, 0.0, -F_z), _Vector3(0.0, 0.0, 0.0)
    return _serialize(_WrenchStamped(_header(stamp), _Wrench(force, torque)), WRENCH)


def clock(stamp: int) -> bytes:
    """Encode a Clock message with the time `stamp` (ns)."""
    return _serialize(_Clock(_time(stamp)), CLOCK)


class MessageTemplate:
    """An encoded message whose stamp and arrays of numbers are replaced in place: ten times as fast as encoding anew.

    Args:
        encode: encodes a message with a stamp (ns) and arrays of the given lengths.
        sizes: lengths of the arrays, in their order in the message; 0 for an array that stays empty.
    """

    def __init__(self, encode: Callable[..., bytes], *sizes: int):
        marks = [np.full(size, 1e300 * (k + 1)) for k, size in enumerate(sizes)]
        self._data = bytearray(encode(0, *marks))
        self._places = [
            slice(start := self._data.index(mark.tobytes()), start + mark.nbytes) if len(mark) else None
            for mark in marks
        ]

    def encode(self, stamp: int, *arrays: NDArray[np.float64]) -> bytes:
        """Return the message with the stamp `stamp` (ns) and the values of the arrays."""
        STAMP.pack_into(self._data, STAMP_OFFSET, stamp // NS_PER_SECOND, stamp % NS_PER_SECOND)
        for place, values in zip(self._places, arrays, strict=True):
            if place is not None:
                self._data[place] = values.tobytes()
        return bytes(self._data)


def read_command(data: bytes, kind: str, motors: Sequence[str]) -> MotorCommand:
    """Decode a command of type `kind`, a JointState or a Float64MultiArray, for the motors with the names `motors`.

    As ros2_control sends it, a JointState may name joints that take no command: it has as many speeds as motors, in the
    order in which it names the motors.
    """
    unknown = np.full(MOTOR_COUNT, math.nan)
    try:
        message: Any = TYPE_STORE.deserialize_cdr(data, kind)
    except Exception as problem:
        # damaged bytes raise errors of many kinds in the decoder
        return MotorCommand(None, unknown, f"unreadable {kind}: {problem}")
    if kind == SPEED_ARRAY:
        mistake = "" if len(message.data) == MOTOR_COUNT else f"{len(message.data)} numbers, expected {MOTOR_COUNT}"
        return MotorCommand(None, unknown if mistake else np.array(message.data), mistake)
    stamp = message.header.stamp.sec * NS_PER_SECOND + message.header.stamp.nanosec
    names, speeds = message.name, message.velocity
    named = names if len(speeds) == len(names) else [one for one in names if one in motors]
    if len(speeds) != len(named) or sorted(one for one in named if one in motors) != sorted(motors):
        more = ["..."] if len(names) > MAX_NAMES else []
        listed = ", ".join([*names[:MAX_NAMES], *more]) or "no joint"
        return MotorCommand(stamp, unknown, f"{len(speeds)} velocities of {listed}; expected {', '.join(motors)}")
    by_name = dict(zip(named, speeds, strict=True))
    return MotorCommand(stamp, np.array([by_name[one] for one in motors]))


def _time(stamp: int) -> Any:
    return _Time(stamp // NS_PER_SECOND, stamp % NS_PER_SECOND)


def _header(stamp: int) -> Any:
    return _Header(_time(stamp), BASE_FRAME)


def _serialize(message: Any, kind: str) -> bytes:
    return bytes(TYPE_STORE.serialize_cdr(message, kind))
