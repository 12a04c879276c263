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
    """Message of a robot with its arrival time.

    Attributes:
        topic: name such as `/joint_states`.
        arrived: arrival by a local steady clock since 1970, or log time of a log (ns).
        data: bytes of the message; a `signals.Reading` for a table.
    """

    topic: str
    arrived: int
    data: Any


class RobotSource(Protocol):
    """Interface of a source of a robot's messages.

    Attributes:
        name: begins error messages.
        has_messages: whether arrivals are messages of topics; otherwise they are readings.
    """

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
        """Subscribe to a published topic of the robot, and return its message encoding and message type.

        Returns:
            Description of the topic; None if the source has readings instead of messages, see `has_messages`.

        Raises:
            LogError: the message type is unknown.
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
    """Bounded queue of messages from a receiving thread to a reading thread.

    Attributes:
        drop_count: number of messages that replaced the oldest message in a full queue.
    """

    def __init__(self, size: int = MAX_BACKLOG):
        self._waiting: deque[Arrival] = deque(maxlen=size)
        self._filled = Condition()
        self.drop_count = 0

    def push(self, arrivals: list[Arrival]) -> None:
        """Append messages to the queue, replacing the oldest if it is full."""
        with self._filled:
            room = (self._waiting.maxlen or 0) - len(self._waiting)
            self.drop_count += max(0, len(arrivals) - room)
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
