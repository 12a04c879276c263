"""Protocol of a source: topics to subscribe to, and their messages as they arrive."""

import time
from collections import deque
from collections.abc import Mapping
from threading import Condition
from typing import Any, NamedTuple, Protocol

from twin.kernel.recording.writer import ForeignTopic

MAX_BACKLOG = 100_000
"""Maximum number of queued messages: more than a minute at 1 kHz."""


class Arrival(NamedTuple):
    """Message on arrival.

    Attributes:
        topic: name such as `/joint_states`.
        arrived: arrival by a local steady clock since 1970, or log time of a log (ns).
        data: bytes of the message; a `signals.Reading` for a table.
    """

    topic: str
    arrived: int
    data: Any


class RobotSource(Protocol):
    """Source of a robot's messages.

    Attributes:
        name: begins error messages.
        has_messages: whether arrivals are messages of topics; otherwise they are readings.
    """

    name: str
    has_messages: bool

    @property
    def at_end(self) -> bool:
        """Whether no more data can arrive."""

    @property
    def drop_count(self) -> int:
        """Number of messages lost by a full queue."""

    def topic_types(self) -> Mapping[str, str]:
        """Topics with publishers -> types of their messages, `sensor_msgs/msg/JointState`."""

    def subscribe(self, topic: str) -> ForeignTopic | None:
        """Subscribe to a published topic, and describe it; None if its arrivals are readings.

        Raises:
            LogError: an unknown type.
        """

    def publisher_count(self, topic: str) -> int:
        """Number of publishers of `topic`."""

    def receive(self, wait: float) -> list[Arrival]:
        """Return the arrivals since the last call, in order; wait up to `wait` (s) for a first one."""

    def now_ns(self) -> int:
        """Present time of the clock of arrivals (ns)."""

    def close(self) -> None:
        """Release the source."""


class Ring:
    """Bounded queue from a receiving thread to a reading one.

    Attributes:
        dropped: number of messages that replaced the oldest one in a full queue.
    """

    def __init__(self, size: int = MAX_BACKLOG):
        self._waiting: deque[Arrival] = deque(maxlen=size)
        self._filled = Condition()
        self.drop_count = 0

    def push(self, arrivals: list[Arrival]) -> None:
        """Append `arrivals`."""
        with self._filled:
            room = (self._waiting.maxlen or 0) - len(self._waiting)
            self.drop_count += max(0, len(arrivals) - room)
            self._waiting.extend(arrivals)
            self._filled.notify()

    def pop_all(self, wait: float) -> list[Arrival]:
        """Return and remove all arrivals; wait up to `wait` (s) for a first one."""
        with self._filled:
            if not self._waiting:
                self._filled.wait(wait)
            taken = list(self._waiting)
            self._waiting.clear()
        return taken


class SteadyClock:
    """Steady clock that starts at the system's time since 1970 (ns)."""

    def __init__(self) -> None:
        self._start = time.time_ns() - time.monotonic_ns()

    def now_ns(self) -> int:
        """Present time (ns)."""
        return self._start + time.monotonic_ns()
