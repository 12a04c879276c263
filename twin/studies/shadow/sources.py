"""Sources of samples named by `--source`: topics of a live robot, or a log."""

import socket
from collections.abc import Mapping
from pathlib import Path

from twin.kernel.errors import InputRefused
from twin.kernel.recording.logs.column_map import TIME_SIGNAL
from twin.kernel.recording.logs.log import LogError, MappedColumn
from twin.kernel.recording.logs.reader import LogKind, kind_of, read_log
from twin.kernel.recording.sources.arrival import RobotSource
from twin.kernel.recording.sources.playback import Playback, logged_topics
from twin.kernel.recording.sources.signals import WantedSignal
from twin.robot.controller.controller import Belief
from twin.studies.shadow.mapping import followed_columns, readings_of

TRANSPORT_NAMES = ("ros2", "zenoh")
JOINT_NAMES = ("m1", "m2", "m3", "l1", "l2", "l3")


def transport_of(source: str) -> str:
    """Parse the transport in a `--source` text, `ros2` for `ros2:/joint_states`; "" for a log."""
    first, colon, _ = source.partition(":")
    return first if colon and first in TRANSPORT_NAMES else ""


def refuse_source(source: str) -> None:
    """Reject an invalid `--source` text before anything is loaded."""
    transport = transport_of(source)
    if transport and not source.partition(":")[2].startswith("/"):
        raise InputRefused(f"--source {source}: expected a topic that begins with /, such as {transport}:/joint_states")
    if not transport and not Path(source).exists():
        first, colon, _ = source.partition(":")
        hint = f"'{first}:' is not a transport; transports are ros2: and zenoh:" if colon else "no such file or folder"
        raise InputRefused(f"--source {source}: {hint}; expected a log, ros2:/TOPIC or zenoh:/TOPIC")


def open_source(
    source: str,
    columns: Mapping[str, MappedColumn],
    wanted: Mapping[str, WantedSignal],
    belief: Belief,
    speed: float,
    notes: list[str],
    part: tuple[float | None, float | None] = (None, None),
) -> tuple[RobotSource, Mapping[str, MappedColumn], bool]:
    """Open a source of samples. Return it, its signals' columns (empty for a recording of twin), and whether it is
    live.

    Args:
        wanted: signals that a map may name.
        notes: list that receives notes on missing data of a log.
        part: start and end (s) of the part of a log, see `read_log`.
    """
    transport, _, topic = source.partition(":")
    if transport_of(source):
        if part != (None, None):
            raise InputRefused(f"--source {source}: --from-s and --to-s need a log; end a session with --duration-s")
        if not set(columns) - {TIME_SIGNAL}:
            raise InputRefused(
                f"--source {source}: name its joints with --map robot.toml, where\n{proposed_map(topic)}"
            )
        columns = followed_columns(f"--source {source}", columns, wanted)
        if not any(column.name.startswith(f"{topic}.") for column in columns.values()):
            named = ", ".join(sorted({column.name.partition(".")[0] for column in columns.values()}))
            raise InputRefused(f"--source {source}: no column of the map is of {topic}; they are of {named}")
        return live_source(transport, source), columns, True
    kind = kind_of(Path(source))
    if kind in (LogKind.RECORDING, LogKind.CSV):
        log = read_log(source, columns, part)
        notes += log.notes
        return Playback(source, readings=readings_of(log, belief), speed=speed), log.columns, False
    topics, found = logged_topics(Path(source), kind, columns)
    notes += found
    if not set(columns) - {TIME_SIGNAL}:
        there = ", ".join(f"{name} ({one.kind})" for name, one in topics.items())
        raise LogError(
            f"{source}: has {there}; name its joints with --map robot.toml, where\n{proposed_map(next(iter(topics)))}"
        )
    columns = followed_columns(source, columns, wanted)
    return Playback(source, topics, speed=speed, part=part, time=columns.get(TIME_SIGNAL)), columns, False


def live_source(transport: str, name: str) -> RobotSource:
    if transport == "zenoh":
        from twin.kernel.recording.sources.zenoh_topics import ZenohSource

        return ZenohSource(name)
    from twin.kernel.recording.sources.dds import DdsSource

    return DdsSource(name)


def waiting_hint(source: str, topics: list[str]) -> str:
    """Explain why topics of a robot may be missing: domain, network interfaces, usual causes."""
    from twin.kernel.recording.sources.dds import domain_id

    names = ", ".join(name for _, name in socket.if_nameindex()) if hasattr(socket, "if_nameindex") else "not known"
    causes = "another ROS_DOMAIN_ID on the robot, ROS_LOCALHOST_ONLY, a network that drops multicast, a firewall"
    if transport_of(source) == "zenoh":
        causes = "another ROS_DOMAIN_ID on the robot, or a router that is not that of ZENOH_SESSION_CONFIG_URI"
    return (
        f"{source}: no publisher of {', '.join(topics)} on domain {domain_id()}, interfaces {names}; usual causes: "
        f"{causes}"
    )


def proposed_map(topic: str) -> str:
    """Create a column map template for a topic with the joints of a robot."""
    names = [f"estimator.theta_{side}[{i}]" for side in "ml" for i in range(3)]
    return "\n".join(f'"{name}" = "{topic}.position.{joint}"' for name, joint in zip(names, JOINT_NAMES, strict=True))
