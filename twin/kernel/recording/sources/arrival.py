"""Protocol of a message source: topics to subscribe to, and their messages as they arrive."""

import time
from collections import deque
from collections.abc import Mapping
from threading import Condition
from typing import Any, NamedTuple, Protocol

from twin.kernel.recording.writer import ForeignTopic

MAX_BACKLOG = 100_000
"""Maximum number of queued messages: more than a minute at 1 kHz."""


class Arrival(NamedTuple):
    """Message of a robot on a topic such as `/joint_states`: bytes, or a `signals.Reading` for a table.

    `arrived` is its arrival by a local steady clock since 1970, or the log time of a log (ns).
    """

    topic: str
    arrived: int
    data: Any


class RobotSource(Protocol):
    """Interface of a source of a robot's messages, or readings unless `has_messages`; `name` begins error messages."""

    name: str
    has_messages: bool

    @property
    def at_end(self) -> bool:
        """Whether the source has ended, so that no more data can arrive."""

    @property
    def drop_count(self) -> int:
        """Number of messages lost by a full queue."""

    def topic_types(self) -> Mapping[str, str]:
        """Published topics -> types of their messages, such as `sensor_msgs/msg/JointState`."""

    def subscribe(self, topic: str) -> ForeignTopic | None:
        """Subscribe to a published topic and return its encoding and type; None for a source of readings.

        Raises:
            LogError: the type of the topic's messages is unknown.
        """

    def publisher_count(self, topic: str) -> int:
        """Return the number of publishers of `topic`."""

    def receive(self, wait: float) -> list[Arrival]:
        """Return the messages received since the last call, in order; wait up to `wait` (s) for the first one."""

    def now_ns(self) -> int:
        """Return the present time of the clock of arrivals (ns)."""

    def close(self) -> None:
        """Close the source and release its resources."""


class Ring:
    """Bounded queue of messages between two threads; `drop_count` of them replaced the oldest in the full queue."""

    def __init__(self) -> None:
        self._waiting: deque[Arrival] = deque(maxlen=MAX_BACKLOG)
        self._filled = Condition()
        self.drop_count = 0

    def push(self, arrivals: list[Arrival]) -> None:
        """Append messages to the queue, replacing the oldest if it is full."""
        with self._filled:
            self.drop_count += max(0, len(self._waiting) + len(arrivals) - MAX_BACKLOG)
            self._waiting.extend(arrivals)
            self._filled.notify()

    def pop_all(self, wait: float) -> list[Arrival]:
        """Return and remove all messages in the queue; wait up to `wait` (s) for the first one."""
        with self._filled:
            if not self._waiting:
                self._filled.wait(wait)
            taken = list(self._waiting)
            self._waiting.clear()
        return taken


class SteadyClock:
    """Monotonic clock that starts at the system's time since 1970 (ns)."""

    def __init__(self) -> None:
        self._start = time.time_ns() - time.monotonic_ns()

    def now_ns(self) -> int:
        """Return the present time of the monotonic clock (ns)."""
        return self._start + time.monotonic_ns()
