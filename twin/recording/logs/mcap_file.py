"""MCAP files that others wrote: checked by their CRCs, read as far as they go (https://mcap.dev/spec)."""

import struct
from collections.abc import Iterator, Mapping
from dataclasses import dataclass, field, replace
from pathlib import Path

import numpy as np
from mcap.exceptions import EndOfFile, McapError
from mcap.records import Channel, Chunk, Header, McapRecord, Message, Schema, Statistics
from mcap.stream_reader import StreamReader, breakup_chunk
from mcap.writer import MCAP0_MAGIC

from twin.errors import nearest
from twin.recording.chunks import allowance, unpacked
from twin.recording.logs import decoding
from twin.recording.logs.column_map import TIME, MappedColumn, split_unit
from twin.recording.logs.csv_head import LARGEST
from twin.recording.logs.errors import LogRefused
from twin.recording.logs.log import Log, LogSeries
from twin.recording.logs.units import unit
from twin.units import Dimension

MAGIC = MCAP0_MAGIC
NANOSECONDS = 1e9
LONGEST_RECORD, LONGEST_HEADER = 2**30, 2**20
"""Bytes; a damaged length must not ask for any amount of memory."""


@dataclass
class LoggedTopic:
    """Messages of one topic.

    Attributes:
        channel, schema: as in the file.
        times: log times, ns.
        data: of the messages.
    """

    channel: Channel
    schema: Schema | None
    times: list[int] = field(default_factory=list)
    data: list[bytes] = field(default_factory=list)


def written_by_twin(path: Path) -> bool:
    """Whether the header of an MCAP file says that `twin.recording` wrote it; a damaged header does not."""
    with path.open("rb") as file:
        try:
            header = next(StreamReader(file, record_size_limit=LONGEST_HEADER).records)
        except (McapError, ValueError, struct.error, StopIteration, OverflowError, MemoryError):
            return False
    return isinstance(header, Header) and header.library.startswith("twin ")


def read_mcap(path: Path, columns: Mapping[str, MappedColumn]) -> Log:
    """The log in the MCAP file `path`; one that ends early is read up to there, and a note says so.

    Args:
        columns: by signal; `/TOPIC.FIELD.FIELD[INDEX]`. `time` is a field that every mapped message has; without it
            the log time.

    Raises:
        LogRefused: damaged, no map, a topic or field that is not there, an encoding other than protobuf and JSON,
            values that are no finite numbers, times that do not ascend; every mistake, each in one sentence.
    """
    topics, note = _topics(path)
    there = ", ".join(f"{name} ({topic.schema.name if topic.schema else 'json'})" for name, topic in topics.items())
    if not any(topic.data for topic in topics.values()):
        raise LogRefused(f"{path}: no messages{f' on {there}' if there else ''}; {note or 'expected a log'}")
    if not set(columns) - {TIME}:
        raise LogRefused(f"{path}: another tool's recording, with {there}; choose with --map NAME=/TOPIC.FIELD[UNIT]")
    mistakes: list[str] = []
    series = {}
    for signal, column in columns.items():
        if signal != TIME:
            try:
                series[signal] = _series(path, topics, signal, column, columns.get(TIME))
            except LogRefused as problem:
                mistakes.append(str(problem))
    if mistakes:
        raise LogRefused("\n".join(dict.fromkeys(mistakes)))
    return Log(path, series, (note,) if note else ())


def _topics(path: Path) -> tuple[dict[str, LoggedTopic], str]:
    """Topics by name, and a sentence on what is missing at the end."""
    schemas: dict[int, Schema] = {}
    channels: dict[int, LoggedTopic] = {}
    with path.open("rb") as file:
        file.seek(-len(MAGIC), 2)
        finished = file.read() == MAGIC and file.tell() > len(MAGIC)
        file.seek(0)
        reader = StreamReader(file, emit_chunks=True, validate_crcs=True, record_size_limit=LONGEST_RECORD)
        note, expected = "", None
        try:
            for record in _records(reader, allowance(path.stat().st_size)):
                if isinstance(record, Schema):
                    schemas[record.id] = record
                elif isinstance(record, Channel):
                    channels.setdefault(record.id, LoggedTopic(record, schemas.get(record.schema_id)))
                elif isinstance(record, Message):
                    channels[record.channel_id].times.append(record.log_time)
                    channels[record.channel_id].data.append(record.data)
                elif isinstance(record, Statistics):
                    expected = record.message_count
        except (McapError, ValueError, LookupError, OverflowError, struct.error, MemoryError) as problem:
            if finished or not isinstance(problem, EndOfFile | struct.error):
                raise LogRefused(
                    f"{path}: damaged near byte {file.tell()}: {problem or 'a record is cut short'}; "
                    "recover what is readable first (mcap recover)"
                ) from None
            note = "the file ends early"
    count = sum(len(topic.data) for topic in channels.values())
    # few writers fill in the CRC of the whole, and a record whose kind is damaged is skipped
    if expected not in (None, count):
        raise LogRefused(f"{path}: damaged: {count} messages where its index says {expected}; mcap recover may help")
    topics: dict[str, LoggedTopic] = {}
    for topic in channels.values():
        # several publishers of a topic have a channel each
        same = topics.setdefault(topic.channel.topic, topic)
        if same is not topic:
            same.times += topic.times
            same.data += topic.data
    last = max((max(t.times) for t in topics.values() if t.times), default=0)
    first = min((min(t.times) for t in topics.values() if t.times), default=0)
    return topics, f"{note}: read {(last - first) / NANOSECONDS:.3f} s of it" if note else ""


def _records(reader: StreamReader, most: int) -> Iterator[McapRecord]:
    """Records of a file, those in its chunks among them, which may unpack to `most` bytes in all."""
    for record in reader.records:
        if isinstance(record, Chunk):
            content = unpacked(record, most)
            most -= len(content)
            yield from breakup_chunk(replace(record, compression="", data=content), validate_crc=True)
        else:
            yield record


def _series(
    path: Path, topics: Mapping[str, LoggedTopic], signal: str, column: MappedColumn, time: MappedColumn | None
) -> LogSeries:
    name = max((n for n in topics if column.name.startswith(f"{n}.")), key=len, default=None)
    if name is None:
        hint = nearest(column.name.partition(".")[0], topics, "it has {}")
        raise LogRefused(f"{path}: no topic of '{column.name}' for {signal}; {hint}")
    topic, field_path = topics[name], column.name.removeprefix(f"{name}.")
    factor = unit(column.unit or split_unit(field_path)[1] or "1", f"{path}: {column.name}")
    values = column.sign * factor.in_si(_numbers(path, name, topic, field_path))
    t = np.array(topic.times, dtype=np.uint64) / NANOSECONDS
    if time is not None:
        stamp = unit(time.unit or split_unit(time.name)[1] or "s", f"{path}: {time.name}")
        if stamp.dimension != Dimension(s=1):
            raise LogRefused(f"{path}: time '{time.name}' is in {time.unit}; expected s, ms, us, ns or min")
        t = stamp.in_si(_numbers(path, name, topic, time.name))
    if len(t) < 2:
        raise LogRefused(f"{path}: {name} has {len(t)} message{'s' * (len(t) != 1)}, expected at least 2")
    # writers need not order messages by time
    order = np.argsort(t, kind="stable")
    t = t[order]
    repeated = np.flatnonzero(np.diff(t) <= 0.0)
    if len(repeated):
        hint = "" if time else "; choose the messages' own stamp with --map time=FIELD"
        raise LogRefused(f"{path}: {name} has two messages at {t[repeated[0]] - t[0]:.9g} s after its first{hint}")
    return LogSeries(t, values[order], factor.si)


def _numbers(path: Path, name: str, topic: LoggedTopic, field_path: str) -> np.ndarray:
    """The numbers at `field_path` of the messages of a topic, (n,)."""
    try:
        decode = decoding.decoder(topic.channel, topic.schema)
        if decode is None:
            raise LogRefused(
                f"{path}: {name} is encoded as {topic.channel.message_encoding or 'nothing known'}; "
                "protobuf and json are read"
            )
        values = np.array([decoding.field(decode(data), field_path) for data in topic.data], dtype=np.float64)
    except LookupError as problem:
        raise LogRefused(f"{path}: {name} has no field '{field_path}'; {problem.args[0]}") from None
    except ValueError as problem:
        raise LogRefused(f"{path}: {name}.{field_path}: {problem}") from None
    # nan is no number either
    wrong = np.flatnonzero(~(np.abs(values) <= LARGEST))
    if len(wrong):
        raise LogRefused(
            f"{path}: {name}.{field_path} is {values[wrong[0]]} in message {wrong[0] + 1} of {len(values)}, "
            "expected numbers"
        )
    return values
