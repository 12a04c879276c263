"""What a source is: topics that are seen and subscribed to, and their messages as they come."""

import time
from collections import deque
from collections.abc import Mapping
from threading import Condition
from typing import Any, NamedTuple, Protocol

from twin.kernel.recording.writer import ForeignTopic

MAX_BACKLOG = 100_000
"""Messages that wait to be taken: more than a minute at 1 kHz."""


class Arrival(NamedTuple):
    """A message.

    Attributes:
        topic: `/joint_states`.
        arrived: when, ns, by a clock of ours that counts from 1970 and never jumps; of a log its log time.
        data: as it came; a log that holds no messages gives a `signals.Reading` in its place.
    """

    topic: str
    arrived: int
    data: Any


class RobotSource(Protocol):
    """Messages of a robot.

    Attributes:
        name: what sentences about it begin with.
        has_messages: whether arrivals are messages, of topics to subscribe to; else they are readings.
    """

    name: str
    has_messages: bool

    @property
    def at_end(self) -> bool:
        """Whether nothing can come any more."""

    @property
    def drop_count(self) -> int:
        """Messages that came and were thrown away, because they were not taken in time."""

    def topic_types(self) -> Mapping[str, str]:
        """Topics that somebody publishes now, and the types of their messages, `sensor_msgs/msg/JointState`."""

    def subscribe(self, topic: str) -> ForeignTopic | None:
        """From now on messages of a `topic` that was seen are taken; None: its arrivals are readings, not messages.

        Raises:
            LogRefused: its type is not known.
        """

    def publisher_count(self, topic: str) -> int:
        """How many publish `topic` now."""

    def receive(self, wait: float) -> list[Arrival]:
        """All that has come since the last call, in the order of arrival; waits up to `wait` s for a first one."""

    def now_ns(self) -> int:
        """The time of the clock of arrivals, ns."""

    def close(self) -> None:
        """Leave."""


class Ring:
    """Where a thread that receives puts messages and another one takes them.

    Attributes:
        dropped: messages that found it full, each of which has pushed out the oldest one.
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
        """All that is there; waits up to `wait` s for a first one."""
        with self._filled:
            if not self._waiting:
                self._filled.wait(wait)
            taken = list(self._waiting)
            self._waiting.clear()
        return taken


class SteadyClock:
    """Time since 1970 (ns) as the system's clock had it at the beginning, and steady from there on."""

    def __init__(self) -> None:
        self._start = time.time_ns() - time.monotonic_ns()

    def now_ns(self) -> int:
        """ns."""
        return self._start + time.monotonic_ns()
