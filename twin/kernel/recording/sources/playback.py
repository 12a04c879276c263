"""Playback of a log as a source: its messages, or the rows of a table, at the pace of their log times."""

import time
from collections.abc import Iterable, Mapping
from contextlib import suppress
from pathlib import Path

import numpy as np

from twin.kernel.recording.logs.log import LogError, MappedColumn
from twin.kernel.recording.logs.reader import WALL_CLOCK, LogKind, interval, no_samples_error, topics_in
from twin.kernel.recording.logs.topics import LoggedTopic, NoField, TopicReading
from twin.kernel.recording.sources.arrival import Arrival
from twin.kernel.recording.writer import ForeignTopic

MAX_BATCH = 512
"""Maximum number of arrivals per call at unlimited speed."""


def logged_topics(
    path: Path, kind: LogKind, columns: Mapping[str, MappedColumn]
) -> tuple[dict[str, LoggedTopic], list[str]]:
    """Read the topics of a bag or of a foreign MCAP file, with messages of `columns`, and notes.

    Raises:
        LogError: the log is damaged or empty.
    """
    topics, notes = topics_in(path, kind, columns)
    if not any(topic.times for topic in topics.values()):
        raise LogError(f"{path}: no messages; expected a log")
    return topics, notes


class Playback:
    """Playback of a log as a source of messages; see `RobotSource`. Arrivals have the log's times at any speed.

    Args:
        topics: topics with their messages; empty for `readings`.
        readings: readings of a table, in order; empty for `topics`.
        speed: 1 for real time, 0 for no limit.
        part: start and end (s) of the part to play, by the times of `read_log`: stamps by `time`, or log times; times
            of a wall clock count from the first message.
        time: field of the messages with the time; None for log times.
    """

    def __init__(
        self,
        name: str,
        topics: Mapping[str, LoggedTopic] = {},
        readings: Iterable[Arrival] = (),
        speed: float = 1.0,
        part: tuple[float | None, float | None] = (None, None),
        time: MappedColumn | None = None,
    ):
        self.name, self.at_end, self.has_messages = name, False, bool(topics)
        self._topics, self._speed, self._part, self._time = topics, speed, part, time
        self._readings = list(readings)
        self._subscribed: dict[str, None] = {}
        self._order: list[Arrival] | None = None
        self._next = 0
        self._now = 0
        self._began = 0.0

    def topic_types(self) -> dict[str, str]:
        return {name: topic.kind for name, topic in self._topics.items() if topic.times}

    def subscribe(self, topic: str) -> ForeignTopic:
        self._subscribed[topic] = None
        channel, schema = self._topics[topic].channel, self._topics[topic].schema
        described = (schema.name, schema.encoding, schema.data) if schema else ("", "", b"")
        return ForeignTopic(topic, channel.message_encoding, *described)

    @property
    def drop_count(self) -> int:
        return 0

    def publisher_count(self, topic: str) -> int:
        return 1

    def receive(self, wait: float) -> list[Arrival]:
        order = self._arrivals()
        if self._next >= len(order):
            self.at_end = True
            return []
        if not self._speed:
            taken = order[self._next : self._next + MAX_BATCH]
        else:
            due = (order[self._next].arrived - order[0].arrived) / 1e9 / self._speed
            time.sleep(min(max(due - (time.monotonic() - self._began), 0.0), wait))
            until = order[0].arrived + (time.monotonic() - self._began) * 1e9 * self._speed
            end = self._next
            while end < len(order) and order[end].arrived <= until:
                end += 1
            taken = order[self._next : end]
        self._next += len(taken)
        if taken:
            self._now = taken[-1].arrived
        return taken

    def now_ns(self) -> int:
        return self._now

    def close(self) -> None:
        """Do nothing; a played log holds no resources."""

    def _arrivals(self) -> list[Arrival]:
        if self._order is None:
            found = list(self._readings)
            times = [one.arrived / 1e9 for one in found]
            for name in self._subscribed:
                topic = self._topics[name]
                found += [Arrival(name, when, data) for when, data in zip(topic.times, topic.data, strict=True)]
                times += self._times(name)
            self._order = sorted(self._clip(found, times), key=lambda one: one.arrived)
            self._began = time.monotonic()
        return self._order

    def _times(self, name: str) -> list[float]:
        """Return the times of the messages of topic `name` (s), to select a part of the log; NaN without a stamp."""
        topic = self._topics[name]
        if self._time is not None and self._part != (None, None):
            with suppress(NoField):
                return TopicReading(Path(self.name), name, topic, self._time, ()).t.tolist()
        return [one / 1e9 for one in topic.times]

    def _clip(self, found: list[Arrival], times: list[float]) -> list[Arrival]:
        """Select the arrivals inside the part of the log to play, by their `times` (s); LogError if there are none."""
        if self._part == (None, None) or not found:
            return found
        first, last = np.nanmin(times), np.nanmax(times)
        shift = first if first > WALL_CLOCK else 0.0
        start, end = interval(self.name, self._part)
        part = [one for one, t in zip(found, times, strict=True) if start <= t - shift <= end]
        if not part:
            raise no_samples_error(self.name, start, end, float(first - shift), float(last - shift))
        return part
