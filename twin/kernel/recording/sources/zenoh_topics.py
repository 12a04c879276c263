"""Source of ROS 2 topics with rmw_zenoh, by eclipse-zenoh without ROS; subscriptions only.

Keys: `DOMAIN/TOPIC/DDS TYPE/HASH`. Publishers are announced by liveliness tokens
`@ros2_lv/DOMAIN/SESSION/NODE/ENTITY/MP/ENCLAVE/NAMESPACE/NODE NAME/TOPIC/DDS TYPE/HASH/QOS`, with % for / in a name
(https://github.com/ros2/rmw_zenoh/blob/rolling/docs/design.md). Type and hash are wildcards, since older releases have
other hashes. The session is a client of the robot's router, because routers no longer forward data between peers.
"""

import os
from collections.abc import Mapping
from typing import Any

from twin.kernel.errors import InputRefused
from twin.kernel.recording.sources.arrival import Arrival, Ring, SteadyClock
from twin.kernel.recording.sources.dds import domain_id
from twin.kernel.recording.writer import ForeignTopic

CONFIG_VARIABLE = "ZENOH_SESSION_CONFIG_URI"
"""Variable with the session's configuration file, as for rmw_zenoh."""
ROUTER_ADDRESS = "tcp/localhost:7447"
TOKEN_PREFIX = "@ros2_lv"
PUBLISHER_ENTITY = "MP"
TOKEN_PARTS = 13
"""Number of parts of a publisher's token."""


class ZenohSource:
    """Source of a robot's messages from zenoh, see `RobotSource`; InputRefused without eclipse-zenoh or a router."""

    def __init__(self, name: str):
        try:
            import zenoh
        except ImportError:
            raise InputRefused(f"--source {name}: needs eclipse-zenoh; pip install 'twin[shadow]'") from None
        self.name, self.at_end, self.has_messages = name, False, True
        self._clock, self._ring, self._domain = SteadyClock(), Ring(), domain_id()
        file = os.environ.get(CONFIG_VARIABLE, "")
        try:
            configuration = zenoh.Config.from_file(file) if file else _client(zenoh)
            self._session = zenoh.open(configuration)
        except zenoh.ZError as problem:
            hint = f"as {CONFIG_VARIABLE}={file} has it" if file else f"at {ROUTER_ADDRESS}"
            why = str(problem).partition("!")[0]
            raise InputRefused(
                f"--source {name}: no router {hint} ({why}); start it on the robot, or name another one in "
                f"{CONFIG_VARIABLE}"
            ) from None
        self._subscriptions: list[Any] = []

    @property
    def drop_count(self) -> int:
        return self._ring.drop_count

    def topic_types(self) -> Mapping[str, str]:
        from twin.kernel.recording.sources.ros_types import ros_name

        return {topic: ros_name(kind) for topic, kind in sorted(self._publishers())}

    def subscribe(self, topic: str) -> ForeignTopic:
        from twin.kernel.recording.sources.ros_types import describe_topic

        found = describe_topic(self.name, topic, self.topic_types()[topic])

        def taken(sample: Any) -> None:
            self._ring.push([Arrival(topic, self._clock.now_ns(), sample.payload.to_bytes())])

        self._subscriptions.append(self._session.declare_subscriber(f"{self._domain}{topic}/*/*", taken))
        return found

    def publisher_count(self, topic: str) -> int:
        return sum(one == topic for one, _ in self._publishers())

    def receive(self, wait: float) -> list[Arrival]:
        return self._ring.pop_all(wait)

    def now_ns(self) -> int:
        return self._clock.now_ns()

    def close(self) -> None:
        self._session.close()

    def _publishers(self) -> list[tuple[str, str]]:
        """List topic and type of every present publisher on zenoh."""
        found = []
        for reply in self._session.liveliness().get(f"{TOKEN_PREFIX}/{self._domain}/**", timeout=0.5):
            parts = str(reply.ok.key_expr).split("/") if reply.ok else []
            if len(parts) == TOKEN_PARTS and parts[5] == PUBLISHER_ENTITY:
                found.append((parts[9].replace("%", "/"), parts[10]))
        return found


def _client(zenoh: Any) -> Any:
    configuration = zenoh.Config()
    for key, value in (("mode", '"client"'), ("connect/endpoints", f'["{ROUTER_ADDRESS}"]')):
        configuration.insert_json5(key, value)
    configuration.insert_json5("scouting/multicast/enabled", "false")
    return configuration
