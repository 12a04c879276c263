"""One topic of a log: its messages as they lie in the file, and the numbers in their fields."""

from array import array
from collections.abc import Sequence
from dataclasses import dataclass, field
from pathlib import Path

import numpy as np
from mcap.records import Channel, Schema
from numpy.typing import NDArray

from twin.recording.logs import decoding
from twin.recording.logs.csv_head import LARGEST
from twin.recording.logs.errors import LogRefused
from twin.recording.logs.ros_messages import unit_of


@dataclass
class LoggedTopic:
    """Messages of one topic.

    Attributes:
        channel, schema: as in an MCAP file.
        times: log times, ns, in the order of the file.
        data: of the messages; empty if no column is of this topic.
    """

    channel: Channel
    schema: Schema | None
    # a list of numbers takes five times the memory
    times: "array[int]" = field(default_factory=lambda: array("Q"))
    data: list[bytes] = field(default_factory=list)

    @property
    def kind(self) -> str:
        """Type of the messages."""
        return self.schema.name if self.schema else "json"


@dataclass(frozen=True)
class Numbers:
    """What the messages of a topic say in one field.

    Attributes:
        values: as they are there, (k,).
        rows: which of the messages have it, ascending, (k,).
        unit: that their type gives it; empty if none.
    """

    values: NDArray[np.float64]
    rows: NDArray[np.int64]
    unit: str


class NoField(LogRefused):
    """The messages of a topic have no such field."""


def numbers_of(
    path: Path, name: str, topic: LoggedTopic, field_paths: Sequence[str]
) -> dict[str, Numbers | LogRefused]:
    """The numbers at each of `field_paths` of the messages of a topic, or why there are none."""
    try:
        decode = decoding.decoder(topic.channel, topic.schema)
    except ValueError as problem:
        raise LogRefused(f"{path}: {name}: {problem}") from None
    if decode is None:
        encoding = topic.channel.message_encoding or "nothing known"
        raise LogRefused(f"{path}: {name} is encoded as {encoding}; protobuf, json and cdr are read")
    found: dict[str, Numbers | LogRefused] = {}
    parts = {one: decoding.path_parts(one) for one in field_paths}
    values = {one: array("d") for one in field_paths}
    rows = {one: array("q") for one in field_paths}
    unnamed: dict[str, str] = {}
    units: dict[str, str] = {}
    for k, data in enumerate(topic.data):
        try:
            message = decode(data)
        except ValueError as problem:
            raise LogRefused(f"{path}: {name}: message {k + 1} of {len(topic.data)}: {problem}") from None
        if not units:
            units = {one: unit_of(message, parts[one]) for one in field_paths}
        for one in field_paths:
            if one in found:
                continue
            try:
                values[one].append(decoding.field(message, parts[one]))
                rows[one].append(k)
            except decoding.Unnamed as problem:
                unnamed[one] = str(problem)
            except LookupError as problem:
                found[one] = NoField(f"{path}: {name} has no field '{one}'; {problem.args[0]}")
            except ValueError as problem:
                found[one] = LogRefused(f"{path}: {name}.{one}: {problem}")
    for one in field_paths:
        if one in found:
            continue
        numbers = np.array(values[one], dtype=np.float64)
        # nan is no number either
        wrong = np.flatnonzero(~(np.abs(numbers) <= LARGEST))
        if len(wrong):
            found[one] = LogRefused(
                f"{path}: {name}.{one} is {numbers[wrong[0]]} in message {rows[one][wrong[0]] + 1} of "
                f"{len(topic.data)}, expected numbers"
            )
        elif not len(numbers):
            found[one] = LogRefused(f"{path}: {name} has no '{one}'; {unnamed.get(one, 'it has no messages')}")
        else:
            found[one] = Numbers(numbers, np.array(rows[one], dtype=np.int64), units[one])
    return found
