"""ROS 2 topics over DDS, by Cyclone DDS without ROS: a source that only subscribes, discovery, undecoded messages.

Readers request best effort and volatile, which every writer offers. The queue is deep: with ROS's default depth of 10 a
reader that stalls for 0.1 s silently loses messages.
"""

import os
from collections.abc import Mapping
from typing import Any

from twin.kernel.errors import InputRefused
from twin.kernel.recording.sources.arrival import Arrival, SteadyClock
from twin.kernel.recording.writer import ForeignTopic

QUEUE_DEPTH = 10_000
"""Number of messages in a reader's queue: 10 s at 1 kHz."""
TOPIC_PREFIX = "rt"
"""Prefix of ROS 2 topics in DDS."""
MAX_BATCH = 500


class RawMessage:
    """DDS message as undecoded bytes; cyclonedds adds `sample_info`."""

    __slots__ = ("data", "sample_info")
    sample_info: Any

    def __init__(self, data: bytes):
        self.data = data


def raw_topic(participant: Any, topic: str, kind: str) -> Any:
    """Create the DDS topic of a ROS 2 topic of type `kind`, whose readers return a `RawMessage` for each message."""
    from cyclonedds.topic import Topic

    from twin.kernel.recording.sources.ros_types import idl_class

    # a separate class, since the type has other users; a subclass would be another type
    raw = idl_class.__wrapped__(kind)
    raw.deserialize = classmethod(lambda cls, data, **_: RawMessage(data))
    return Topic(participant, TOPIC_PREFIX + topic, raw)


class TopicDiscovery:
    """Publishers of ROS 2 topics that a DDS `participant` has discovered, including its own."""

    def __init__(self, participant: Any):
        from cyclonedds.builtin import BuiltinDataReader, BuiltinTopicDcpsPublication

        self._discovery = BuiltinDataReader(participant, BuiltinTopicDcpsPublication)
        self._published: dict[Any, tuple[str, str]] = {}

    def topic_types(self) -> Mapping[str, str]:
        """Return published topics -> types of their messages, without ROS's own discovery topics."""
        from twin.kernel.recording.sources.ros_types import ros_name

        self._update()
        found = dict(self._published.values())
        own = ("ros_discovery_info", "/rosout", "/parameter_events")
        return {topic: ros_name(kind) for topic, kind in sorted(found.items()) if topic not in own}

    def publisher_count(self, topic: str) -> int:
        """Return the number of publishers of `topic`."""
        self._update()
        return sum(one == topic for one, _ in self._published.values())

    def _update(self) -> None:
        from cyclonedds.core import InstanceState

        while found := self._discovery.take(MAX_BATCH):
            for one in found:
                alive = one.sample_info.instance_state == InstanceState.Alive
                if alive and one.topic_name.startswith(f"{TOPIC_PREFIX}/"):
                    self._published[one.key] = one.topic_name.removeprefix(TOPIC_PREFIX), one.type_name
                else:
                    self._published.pop(one.key, None)


class DdsSource:
    """Source of a robot's messages from DDS, see `RobotSource`; InputRefused without cyclonedds or a usable network."""

    def __init__(self, name: str):
        try:
            from cyclonedds.core import DDSException, Policy, Qos, WaitSet
            from cyclonedds.domain import DomainParticipant
        except ImportError:
            raise InputRefused(f"--source {name}: needs cyclonedds; pip install 'twin[shadow]'") from None
        self.name, self.at_end, self.has_messages = name, False, True
        self._clock = SteadyClock()
        domain = domain_id()
        try:
            self._participant = DomainParticipant(domain)
        except DDSException as problem:
            raise InputRefused(f"--source {name}: DDS cannot begin on domain {domain}: {problem}") from None
        self._qos = Qos(Policy.Reliability.BestEffort, Policy.Durability.Volatile, Policy.History.KeepLast(QUEUE_DEPTH))
        self._discovery = TopicDiscovery(self._participant)
        self._readers: list[tuple[str, Any]] = []
        self._waiting, self._conditions = WaitSet(self._participant), list[Any]()

    @property
    def drop_count(self) -> int:
        return sum(reader.get_sample_lost_status().total_count for _, reader in self._readers)

    def topic_types(self) -> Mapping[str, str]:
        return self._discovery.topic_types()

    def subscribe(self, topic: str) -> ForeignTopic:
        from cyclonedds.core import InstanceState, ReadCondition, SampleState, ViewState
        from cyclonedds.sub import DataReader

        from twin.kernel.recording.sources.ros_types import describe_topic

        found = describe_topic(self.name, topic, self.topic_types()[topic])
        described = raw_topic(self._participant, topic, found.type_name)
        reader: Any = DataReader(self._participant, described, qos=self._qos)
        unread = SampleState.NotRead | ViewState.Any | InstanceState.Any
        condition = ReadCondition(reader, unread)
        self._waiting.attach(condition)
        self._readers.append((topic, reader))
        self._conditions.append(condition)
        return found

    def publisher_count(self, topic: str) -> int:
        return self._discovery.publisher_count(topic)

    def receive(self, wait: float) -> list[Arrival]:
        self._waiting.wait(round(wait * 1e9))
        found: list[Arrival] = []
        for topic, reader in self._readers:
            taken = reader.take(MAX_BATCH)
            now = self._clock.now_ns()
            # no data: a writer has left
            found += [Arrival(topic, now, one.data) for one in taken if isinstance(one, RawMessage)]
        return found

    def now_ns(self) -> int:
        return self._clock.now_ns()

    def close(self) -> None:
        """Do nothing: DDS is released with the last reference to it."""


def domain_id() -> int:
    """Return the DDS domain number from ROS_DOMAIN_ID; 0 if it is not set, InputRefused for other text."""
    text = os.environ.get("ROS_DOMAIN_ID", "") or "0"
    if not text.isdigit() or int(text) > 232:
        raise InputRefused(f"ROS_DOMAIN_ID={text}: expected a number from 0 to 232")
    return int(text)
