"""Topics of ROS 2 robots with rmw_zenoh, by eclipse-zenoh, without ROS: subscribed to, never published.

Keys: `DOMAIN/TOPIC/DDS TYPE/HASH`; who publishes what is in liveliness tokens
`@ros2_lv/DOMAIN/SESSION/NODE/ENTITY/MP/ENCLAVE/NAMESPACE/NODE NAME/TOPIC/DDS TYPE/HASH/QOS`, with % for / in a name
(https://github.com/ros2/rmw_zenoh/blob/rolling/docs/design.md). Type and hash are left open, since older releases have
other hashes. The session is a client of the robot's router, as routers no longer hand on what peers send each other.
"""

import os
from collections.abc import Mapping
from typing import Any

from twin.kernel.errors import InputRefused
from twin.kernel.recording.sources.arrival import Arrival, Ring, SteadyClock
from twin.kernel.recording.sources.dds import domain_id
from twin.kernel.recording.writer import OthersTopic

CONFIGURATION = "ZENOH_SESSION_CONFIG_URI"
"""A file for the session, as rmw_zenoh has it."""
ROUTER = "tcp/localhost:7447"
TOKENS = "@ros2_lv"
PUBLISHER = "MP"
PARTS = 13
"""Of a token of a publisher."""


class ZenohSource:
    """See `RobotSource`.

    Raises:
        InputRefused: eclipse-zenoh is not installed, or there is no router.
    """

    def __init__(self, name: str):
        try:
            import zenoh
        except ImportError:
            raise InputRefused(f"--source {name}: needs eclipse-zenoh; pip install 'twin[shadow]'") from None
        self.name, self.ended, self.has_messages = name, False, True
        self._clock, self._ring, self._domain = SteadyClock(), Ring(), domain_id()
        file = os.environ.get(CONFIGURATION, "")
        try:
            configuration = zenoh.Config.from_file(file) if file else _client(zenoh)
            self._session = zenoh.open(configuration)
        except zenoh.ZError as problem:
            hint = f"as {CONFIGURATION}={file} has it" if file else f"at {ROUTER}"
            why = str(problem).partition("!")[0]
            raise InputRefused(
                f"--source {name}: no router {hint} ({why}); start it on the robot, or name another one in "
                f"{CONFIGURATION}"
            ) from None
        self._subscriptions: list[Any] = []

    @property
    def dropped(self) -> int:
        return self._ring.dropped

    def seen(self) -> Mapping[str, str]:
        from twin.kernel.recording.sources.ros_types import ros_name

        return {topic: ros_name(kind) for topic, kind in sorted(self._publishers())}

    def subscribe(self, topic: str) -> OthersTopic:
        from twin.kernel.recording.sources.ros_types import described

        found = described(self.name, topic, self.seen()[topic])

        def taken(sample: Any) -> None:
            self._ring.put([Arrival(topic, self._clock.now(), sample.payload.to_bytes())])

        self._subscriptions.append(self._session.declare_subscriber(f"{self._domain}{topic}/*/*", taken))
        return found

    def publishers(self, topic: str) -> int:
        return sum(one == topic for one, _ in self._publishers())

    def take(self, wait: float) -> list[Arrival]:
        return self._ring.take(wait)

    def now(self) -> int:
        return self._clock.now()

    def close(self) -> None:
        self._session.close()

    def _publishers(self) -> list[tuple[str, str]]:
        """Topic and type of each publisher that is there."""
        found = []
        for reply in self._session.liveliness().get(f"{TOKENS}/{self._domain}/**", timeout=0.5):
            parts = str(reply.ok.key_expr).split("/") if reply.ok else []
            if len(parts) == PARTS and parts[5] == PUBLISHER:
                found.append((parts[9].replace("%", "/"), parts[10]))
        return found


def _client(zenoh: Any) -> Any:
    configuration = zenoh.Config()
    for key, value in (("mode", '"client"'), ("connect/endpoints", f'["{ROUTER}"]')):
        configuration.insert_json5(key, value)
    configuration.insert_json5("scouting/multicast/enabled", "false")
    return configuration
