"""Bags as labs record them, made with rosbags, which is not ours."""

import sqlite3
from collections.abc import Sequence
from contextlib import closing
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from rosbags.rosbag2 import CompressionFormat, CompressionMode, StoragePlugin, Writer
from rosbags.typesys import Stores, get_types_from_msg, get_typestore

from twin.kernel.recording.logs.column_map import column_map
from twin.kernel.recording.logs.log import Log, LogError
from twin.kernel.recording.logs.reader import read_log

OWN = "robot_msgs/msg/Tool"
STORE = get_typestore(Stores.ROS2_HUMBLE)
OWN_TEXT = "builtin_interfaces/Time when\nfloat64 F_N\nfloat32[3] q\nfloat64 stamp\nuint8 from\nstring note\n"
STORE.register(get_types_from_msg(OWN_TEXT, OWN))
NS = 1_000_000_000
START = 1_700_000_000.0
N = 20
TICKS = [START + 0.01 * k for k in range(N)]


def message(kind: str, **fields: Any) -> Any:
    """A message of type `kind`."""
    return STORE.types[kind](**fields)


def header(stamp: float) -> Any:
    ns = round(stamp * NS)
    time = message("builtin_interfaces/msg/Time", sec=ns // NS, nanosec=ns % NS)
    return message("std_msgs/msg/Header", stamp=time, frame_id="base")


def vector(*xyz: float) -> Any:
    return message("geometry_msgs/msg/Vector3", **dict(zip("xyz", xyz, strict=True)))


def joints(stamp: float, **positions: float) -> Any:
    return message(
        "sensor_msgs/msg/JointState",
        header=header(stamp),
        name=list(positions),
        position=np.array(list(positions.values()), dtype=np.float64),
        velocity=np.array([], dtype=np.float64),
        effort=-10.0 * np.array(list(positions.values()), dtype=np.float64),
    )


def wrench(stamp: float, F_z: float) -> Any:
    inner = message("geometry_msgs/msg/Wrench", force=vector(0.0, 0.0, F_z), torque=vector(0.0, 0.0, 0.0))
    return message("geometry_msgs/msg/WrenchStamped", header=header(stamp), wrench=inner)


def pose(stamp: float, z: float) -> Any:
    point = message("geometry_msgs/msg/Point", x=0.0, y=0.0, z=z)
    turn = message("geometry_msgs/msg/Quaternion", x=0.0, y=0.0, z=0.0, w=1.0)
    inner = message("geometry_msgs/msg/Pose", position=point, orientation=turn)
    return message("geometry_msgs/msg/PoseStamped", header=header(stamp), pose=inner)


def twist(stamp: float, v_z: float) -> Any:
    inner = message("geometry_msgs/msg/Twist", linear=vector(0.0, 0.0, v_z), angular=vector(0.0, 0.0, 0.0))
    return message("geometry_msgs/msg/TwistStamped", header=header(stamp), twist=inner)


def numbers(*data: float) -> Any:
    layout = message("std_msgs/msg/MultiArrayLayout", dim=[], data_offset=0)
    return message("std_msgs/msg/Float64MultiArray", layout=layout, data=np.array(data, dtype=np.float64))


def own(when: float, F_N: float, stamp: float = 0.0) -> Any:
    return message(
        OWN,
        when=header(when).stamp,
        F_N=F_N,
        q=np.array([1.0, 2.0, 4.0], dtype=np.float32),
        stamp=stamp,
        from_=3,
        note="x",
    )


def bag(
    folder: Path,
    topics: dict[str, Sequence[tuple[float, Any]]],
    storage: str = "mcap",
    compressed: str = "",
) -> Path:
    """A bag in `folder` with messages (log time in s, message) by topic."""
    writer = Writer(folder, version=9, storage_plugin=StoragePlugin[storage.upper()])
    if compressed:
        writer.set_compression(CompressionMode[compressed.upper()], CompressionFormat.ZSTD)
    with writer:
        rows = []
        for name, messages in topics.items():
            kind = messages[0][1].__msgtype__
            connection = writer.add_connection(name, kind, typestore=STORE)
            rows += [(round(t * NS), connection, bytes(STORE.serialize_cdr(one, kind))) for t, one in messages]
        for t, connection, data in sorted(rows, key=lambda row: row[0]):
            writer.write(connection, t, data)
    return folder


def logged(path: Path, *maps: str) -> Log:
    return read_log(path, column_map(maps))


def refusal(path: Path, *maps: str) -> str:
    with pytest.raises(LogError) as refused:
        logged(path, *maps)
    return str(refused.value)


def sqlite_bag(folder: Path, *statements: str) -> Path:
    """A bag of /tool, whose type only the robot's own package defines, changed by `statements`; its one file."""
    path = bag(folder, {"/tool": [(t, own(t, 2.0)) for t in TICKS]}, "sqlite3") / f"{folder.name}.db3"
    with closing(sqlite3.connect(path)) as rows:
        for statement in statements:
            rows.execute(statement)
        rows.commit()
    return path
