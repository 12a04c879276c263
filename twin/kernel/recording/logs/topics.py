"""Topics of a log: their messages, the series of a column map, and the reader of MCAP files (https://mcap.dev/spec)."""

import struct
import zlib
from array import array
from collections.abc import Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass, field
from io import BytesIO
from pathlib import Path

import numpy as np
from mcap.data_stream import ReadDataStream
from mcap.exceptions import EndOfFile, McapError
from mcap.opcode import Opcode
from mcap.records import Channel, Chunk, Header, McapRecord, Message, Schema, Statistics
from mcap.stream_reader import StreamReader
from mcap.writer import MCAP0_MAGIC
from numpy.typing import NDArray

from twin.kernel.errors import nearest
from twin.kernel.recording.logs import decoding
from twin.kernel.recording.logs.column_map import TIME_SIGNAL, require_unit, split_unit
from twin.kernel.recording.logs.log import MAX_QUANTITY, Log, LogError, LogSeries, MappedColumn, NoNumbers
from twin.kernel.recording.messages import NS_PER_S, RECORD_PREFIX
from twin.kernel.recording.summary import decompress_chunk, unpack_allowance
from twin.kernel.units import Dimension, Unit

STAMP_FIELD = "header.stamp"
MAX_CLOCK_DIFFERENCE = 1.0
"""Maximum difference of log times and stamps of one clock (s)."""
MAX_OVERTAKING, MAX_OVERTAKING_PERIODS = 0.1, 10.0
"""Maximum reordering of messages (s, and in periods; the larger holds): times that go back further are a restart. Two
publishers and a network cause some milliseconds."""
MAX_STAMP_DELAY, MAX_DELAY_DRIFT = 0.1, 0.02
"""Maximum delay of stamps behind log times of the same clock, and maximum change of the delay (s): a camera has such a
delay, a robot's drive has not."""
END_DIVISOR = 8
"""Divisor of the number of messages: this fraction at either end of a log determines the delay there."""
MCAP_MAGIC = MCAP0_MAGIC
_PREFIX_STRUCT, _MESSAGE_STRUCT = struct.Struct("<BQ"), struct.Struct("<HIQQ")
"""Head of every record, and of a message record: https://mcap.dev/spec#message-op0x05."""
MAX_RECORD_BYTES, MAX_HEADER_BYTES = 2**30, 2**20
"""Maximum sizes (bytes), since a damaged length must not allocate any amount of memory."""


@dataclass
class LoggedTopic:
    """Messages of a topic in the order of the file: log times (ns) and bytes, empty if no column is of this topic."""

    channel: Channel
    schema: Schema | None
    # an array needs a fifth of a list's memory
    times: "array[int]" = field(default_factory=lambda: array("Q"))
    data: list[bytes] = field(default_factory=list)

    @property
    def kind(self) -> str:
        """Name of the type of the topic's messages."""
        return self.schema.name if self.schema else "json"


def maps_topic(topic: str, columns: Mapping[str, MappedColumn]) -> bool:
    """Check whether one of the mapped `columns` may belong to `topic`."""
    return any(column.name.startswith(f"{topic}.") for column in columns.values())


def factor_of(column: MappedColumn, field_path: str, of_type: str, where: Path | str) -> Unit:
    """Return a column's unit: the map's, the message's type's, the field name's, or 1; LogError begins with `where`."""
    return require_unit(column.unit or of_type or split_unit(field_path)[1] or "1", f"{where}: {column.name}")


def time_factor(column: MappedColumn, where: str) -> Unit:
    """Return the unit of a field of messages with their time, seconds by default; LogError begins with `where`."""
    factor = require_unit(column.unit or split_unit(column.name)[1] or "s", f"{where}: {column.name}")
    if factor.dimension != Dimension(s=1):
        raise LogError(f"{where}: time '{column.name}' is in {column.unit}; expected s, ms, us, ns or min")
    return factor


def message_decoder(channel: Channel, schema: Schema | None, where: str) -> decoding.Decoder:
    """Create the decoder of a topic's messages; LogError (from `where`): an unsupported encoding, an invalid schema."""
    try:
        decode = decoding.decoder(channel, schema)
    except ValueError as problem:
        raise LogError(f"{where}: {problem}") from None
    if decode is None:
        encoding = channel.message_encoding or "nothing known"
        raise LogError(f"{where} is encoded as {encoding}; protobuf, json and cdr are read")
    return decode


def merge_topics(found: Iterable[LoggedTopic]) -> dict[str, LoggedTopic]:
    """Merge the messages of several publishers of a topic, in order of time; topics by name."""
    topics: dict[str, LoggedTopic] = {}
    for topic in found:
        same = topics.setdefault(topic.channel.topic, topic)
        if same is not topic:
            times, data = np.concatenate([same.times, topic.times]), [*same.data, *topic.data]
            order = np.argsort(times, kind="stable")
            same.times = array("Q", times[order].tobytes())
            same.data = [data[k] for k in order] if data else []
    return topics


def log_from_topics(
    path: Path, topics: Mapping[str, LoggedTopic], columns: Mapping[str, MappedColumn], notes: Sequence[str] = ()
) -> Log:
    """Create a log of the series that `columns` select from `topics`: signal -> `/TOPIC.FIELD.FIELD[INDEX]`.

    `time` is a field of the mapped messages; without it log times are used. LogError: no map, missing topics or fields,
    unsupported encodings, values that are not finite, times that do not ascend or restart; a sentence for each error.
    """
    there = ", ".join(f"{name} ({topic.kind})" for name, topic in topics.items())
    if not any(topic.times for topic in topics.values()):
        raise LogError(f"{path}: no messages{f' on {there}' if there else ''}; {'; '.join(notes) or 'expected a log'}")
    if not set(columns) - {TIME_SIGNAL}:
        raise LogError(f"{path}: another tool's recording, with {there}; choose with --map NAME=/TOPIC.FIELD[UNIT]")
    mistakes: list[str] = []
    sources: dict[str, dict[str, str]] = {}
    for signal, column in columns.items():
        if signal != TIME_SIGNAL:
            name = max((one for one in topics if column.name.startswith(f"{one}.")), key=len, default=None)
            if name is None:
                hint = nearest(column.name.partition(".")[0], topics, "it has {}")
                mistakes.append(f"{path}: no topic of '{column.name}' for {signal}; {hint}")
            else:
                sources.setdefault(name, {})[signal] = column.name.removeprefix(f"{name}.")
    readings, remarks = _readings(path, topics, columns.get(TIME_SIGNAL), sources, mistakes)
    series: dict[str, LogSeries] = {}
    left_out: dict[str, str] = {}
    for name, reading in readings.items():
        for signal, field_path in sources[name].items():
            try:
                series[signal] = reading.series(field_path, columns[signal])
            except NoNumbers as problem:
                left_out[signal] = str(problem)
            except LogError as problem:
                mistakes.append(str(problem))
    if mistakes or not series:
        raise LogError("\n".join(dict.fromkeys([*mistakes, *left_out.values()])))
    remarks += [f"left out: {text.removeprefix(f'{path}: ')}" for text in left_out.values()]
    return Log(
        path, {name: series[name] for name in columns if name in series}, (*notes, *remarks), (), left_out, columns
    )


def _readings(
    path: Path,
    topics: Mapping[str, LoggedTopic],
    time: MappedColumn | None,
    sources: Mapping[str, Mapping[str, str]],
    mistakes: list[str],
) -> tuple[dict[str, "TopicReading"], list[str]]:
    """Decode every topic of `sources` into numbers, with notes on clocks; errors are appended to `mistakes`.

    If other topics have the field of time, a topic without it uses its log times, if both are of one clock.
    """
    readings: dict[str, TopicReading] = {}
    timeless: dict[str, NoField] = {}
    notes: list[str] = []
    for name, signals in sources.items():
        try:
            readings[name] = TopicReading(path, name, topics[name], time, tuple(signals.values()))
            notes += readings[name].notes
        except NoField as problem:
            timeless[name] = problem
        except LogError as problem:
            mistakes.append(str(problem))
    furthest = max(readings.items(), key=lambda one: abs(one[1].delay), default=None)
    for name, lacking in timeless.items():
        assert time is not None
        if furthest is None:
            mistakes.append(str(lacking))
        elif abs(furthest[1].delay) > MAX_CLOCK_DIFFERENCE:
            mistakes.append(
                f"{lacking}; its log times cannot be used, they differ by {abs(furthest[1].delay):.6g} s from the "
                f"stamps of {furthest[0]}: leave out --map time=... to use log times for all"
            )
        else:
            try:
                readings[name] = TopicReading(path, name, topics[name], None, tuple(sources[name].values()))
                notes.append(f"{name} has no {time.name}: its log times are used")
            except LogError as problem:
                mistakes.append(str(problem))
    return readings, notes


class TopicReading:
    """Decoded messages of one topic, as numbers over time `t` (n,), s, NaN without a time; `notes` on its clocks.

    `delay` is the delay of log times behind stamps (s); 0 without stamps.
    """

    def __init__(
        self, path: Path, name: str, topic: LoggedTopic, time: MappedColumn | None, field_paths: Sequence[str]
    ) -> None:
        """Decode the needed fields of a topic once, and determine its times from the field `time`, else log times.

        Raises:
            LogError: an unsupported encoding, an undecodable message, or invalid times.
        """
        self._path, self._name = path, name
        logged = np.array(topic.times, dtype=np.uint64) / NS_PER_S
        if len(logged) < 2:
            many = "s" * (len(logged) != 1)
            raise LogError(f"{path}: {name} has {len(logged)} message{many}, expected at least 2")
        stamp_path = time.name if time else STAMP_FIELD
        self._found = field_numbers(path, name, topic, tuple(dict.fromkeys((*field_paths, stamp_path))))
        stamps = self._found[stamp_path]
        self.notes: list[str] = []
        self._by_stamp = time is not None
        self.t = logged if time is None else self._stamp_times(time, stamps, len(logged))
        self.delay = 0.0
        if isinstance(stamps, Numbers) and len(stamps.rows) == len(logged) and np.any(stamps.values):
            stamped = stamps.values if time is None else self.t
            self.delay = float(np.median(logged - stamped))
            note = clock_note(name, logged, stamped, by_stamp=time is not None)
            self.notes += [note] if note else []

    def series(self, field_path: str, column: MappedColumn) -> LogSeries:
        """Return the values of a message field as a series, in SI and in order of time.

        Raises:
            LogError: no such field or unit, no numbers, equal times or a restart.
        """
        where = f"{self._path}: {self._name}"
        numbers = self._found[field_path]
        if isinstance(numbers, LogError):
            raise numbers
        factor = factor_of(column, field_path, numbers.unit, self._path)
        stamped = np.isfinite(self.t[numbers.rows])
        rows, t = numbers.rows[stamped], self.t[numbers.rows[stamped]]
        if len(t) < 2:
            raise NoNumbers(f"{where}.{field_path} is in {len(t)} message, expected at least 2")
        if again := restart_index(t):
            instead = "leave out --map time=... to take log times" if self._by_stamp else "choose --map time=FIELD"
            raise LogError(
                f"{where}: its {'stamps' if self._by_stamp else 'log times'} restart at message "
                f"{rows[again] + 1} of {len(self.t)}: from {t[again - 1]:.6f} s back to {t[again]:.6f} s; cut "
                f"the log there, or {instead}"
            )
        # writers need not order messages by time
        order = np.argsort(t, kind="stable")
        t, values = t[order], column.sign * factor.in_si(numbers.values[stamped])[order]
        repeated = np.flatnonzero(np.diff(t) <= 0.0)
        if len(repeated):
            hint = "" if self._by_stamp else "; choose the messages' own stamp with --map time=FIELD"
            raise LogError(f"{where} has two messages at {t[repeated[0]] - t[0]:.9g} s after its first{hint}")
        invalid = self.t[numbers.invalid]
        return LogSeries(t, values, factor.si, np.sort(invalid[np.isfinite(invalid)]))

    def _stamp_times(self, time: MappedColumn, stamps: "Numbers | LogError", count: int) -> NDArray[np.float64]:
        """Compute the times of the `count` messages from their stamps (s); NaN without a stamp."""
        if isinstance(stamps, LogError):
            raise stamps
        factor = time_factor(time, str(self._path))
        if not np.any(stamps.values):
            raise LogError(
                f"{self._path}: {self._name}.{time.name} is 0 in all messages: the publisher sets none; leave "
                "out --map time=... to take log times"
            )
        t = np.full(count, np.nan)
        t[stamps.rows] = factor.in_si(stamps.values)
        return t


@dataclass(frozen=True)
class Numbers:
    """Values (k,) of a field in the messages `rows` (ascending) of a topic; the unit is by their type, "" without one.

    `invalid` are indices of further messages with NaN, null or infinity.
    """

    values: NDArray[np.float64]
    rows: NDArray[np.int64]
    unit: str
    invalid: NDArray[np.int64]


class NoField(LogError):
    """Error for a field that the messages of a topic lack."""


def field_numbers(
    path: Path, name: str, topic: LoggedTopic, field_paths: Sequence[str]
) -> dict[str, Numbers | LogError]:
    """Extract the values at each of `field_paths` from a topic's messages, or the error for the path."""
    decode = message_decoder(topic.channel, topic.schema, f"{path}: {name}")
    found: dict[str, Numbers | LogError] = {}
    parts = {one: decoding.path_parts(one) for one in field_paths}
    values = {one: array("d") for one in field_paths}
    rows = {one: array("q") for one in field_paths}
    unnamed: dict[str, str] = {}
    units: dict[str, str] = {}
    for k, data in enumerate(topic.data):
        try:
            message = decode(data)
        except ValueError as problem:
            raise LogError(f"{path}: {name}: message {k + 1} of {len(topic.data)}: {problem}") from None
        if not units:
            units = {one: decoding.unit_of(message, parts[one]) for one in field_paths}
        for one in field_paths:
            if one in found:
                continue
            try:
                values[one].append(decoding.field_value(message, parts[one]))
                rows[one].append(k)
            except decoding.UnknownElement as problem:
                unnamed.setdefault(one, str(problem))
            except LookupError as problem:
                found[one] = NoField(f"{path}: {name} has no field '{one}'; {problem.args[0]}")
            except ValueError as problem:
                found[one] = LogError(f"{path}: {name}.{one}: {problem}")
    for one in field_paths:
        if one in found:
            continue
        numbers, there = np.array(values[one], dtype=np.float64), np.array(rows[one], dtype=np.int64)
        # false for NaN
        valid = np.abs(numbers) <= MAX_QUANTITY
        if not len(numbers):
            found[one] = NoField(f"{path}: {name} has no field '{one}'; {unnamed.get(one, 'it has no messages')}")
        elif not np.any(valid):
            found[one] = NoNumbers(f"{path}: {name}.{one} is {numbers[0]} in all messages, expected numbers")
        else:
            found[one] = Numbers(numbers[valid], there[valid], units[one], there[~valid])
    return found


def restart_index(t: NDArray[np.float64]) -> int:
    """Find the index of the first restart of a log's clock, where the times t (n,), n >= 2, in s, go back; else 0."""
    steps = np.diff(t)
    back = np.flatnonzero(steps < -max(MAX_OVERTAKING, MAX_OVERTAKING_PERIODS * float(np.median(np.abs(steps)))))
    return int(back[0]) + 1 if len(back) else 0


def clock_note(name: str, logged: NDArray[np.float64], stamps: NDArray[np.float64], by_stamp: bool) -> str:
    """Create the note that stamps are of another clock than the log's; empty if not. Times (n,), s, as logged."""
    if not by_stamp and (again := restart_index(stamps)):
        return (
            f"the stamps of {name} restart {logged[again] - logged[0]:.3f} s after its first message: "
            f"from {stamps[again - 1]:.3f} s back to {stamps[again]:.3f} s"
        )
    delay = logged - stamps
    few = max(1, len(delay) // END_DIVISOR)
    first, last = float(np.median(delay[:few])), float(np.median(delay[-few:]))
    if abs(first) <= MAX_STAMP_DELAY and abs(last - first) <= MAX_DELAY_DRIFT:
        return ""
    where = "behind" if first > 0.0 else "ahead of"
    change = f", and by {abs(last - first):.3f} s {'more' if abs(last) > abs(first) else 'less'} at the end"
    used = "stamps" if by_stamp else "log times"
    return (
        f"two clocks: the stamps of {name} are {abs(first):.3f} s {where} its log times"
        f"{change if abs(last - first) > MAX_DELAY_DRIFT else ''}; {used} are used"
    )


def written_by_twin(path: Path) -> bool:
    """Check whether the header of an MCAP file names `twin.kernel.recording` as its writer; false if it is damaged."""
    with path.open("rb") as file:
        try:
            header = next(StreamReader(file, record_size_limit=MAX_HEADER_BYTES).records)
        except (McapError, ValueError, struct.error, StopIteration, OverflowError, MemoryError):
            return False
    return isinstance(header, Header) and header.library.startswith("twin ")


def mcap_topics(path: Path, columns: Mapping[str, MappedColumn]) -> tuple[dict[str, LoggedTopic], list[str]]:
    """Read the topics of an MCAP file, with the messages of `columns`, and a note on a truncated end."""
    found, note = read_topics(path, columns)
    return merge_topics(found), [note] if note else []


def read_topics(
    path: Path, columns: Mapping[str, MappedColumn], file: Path | None = None
) -> tuple[list[LoggedTopic], str]:
    """Read the topics, with messages of `columns`, of an MCAP file by publisher, and a note on a truncated end.

    `file` is the compressed file, named in error messages instead. LogError: damaged.
    """
    where = file or path
    schemas: dict[int, Schema] = {}
    channels: dict[int, LoggedTopic] = {}
    chosen_ids: set[int] = set()
    with path.open("rb") as content:
        content.seek(-len(MCAP_MAGIC), 2)
        finished = content.read() == MCAP_MAGIC and content.tell() > len(MCAP_MAGIC)
        content.seek(0)
        reader = StreamReader(content, emit_chunks=True, validate_crcs=True, record_size_limit=MAX_RECORD_BYTES)
        note, expected = "", None
        try:
            for record in _records(reader, unpack_allowance(path.stat().st_size)):
                if isinstance(record, Schema):
                    schemas[record.id] = record
                elif isinstance(record, Channel):
                    channels.setdefault(record.id, LoggedTopic(record, schemas.get(record.schema_id)))
                    if maps_topic(record.topic, columns):
                        chosen_ids.add(record.id)
                elif isinstance(record, Message):
                    channels[record.channel_id].times.append(record.log_time)
                    if record.channel_id in chosen_ids:
                        channels[record.channel_id].data.append(record.data)
                elif isinstance(record, Statistics):
                    expected = record.message_count
        except (McapError, ValueError, LookupError, OverflowError, struct.error, MemoryError) as problem:
            if finished or not isinstance(problem, EndOfFile | struct.error):
                raise LogError(
                    f"{where}: damaged near byte {content.tell()}: {problem or 'a record is cut short'}; "
                    "recover what is readable first (mcap recover)"
                ) from None
            note = "the file ends early"
    topics = list(channels.values())
    count = sum(len(topic.times) for topic in topics)
    # few writers fill in the CRC of the whole, and a record whose kind is damaged is skipped
    if expected not in (None, count):
        raise LogError(f"{where}: damaged: {count} messages where its index says {expected}; mcap recover may help")
    last = max((max(t.times) for t in topics if t.times), default=0)
    first = min((min(t.times) for t in topics if t.times), default=0)
    return topics, f"{note}: read {(last - first) / NS_PER_S:.3f} s of it" if note else ""


def _records(reader: StreamReader, most: int) -> Iterator[McapRecord]:
    """Yield the records of an MCAP file, including records in chunks, which may decompress to at most `most` bytes."""
    for record in reader.records:
        if isinstance(record, Chunk):
            content = decompress_chunk(record, most)
            most -= len(content)
            if record.uncompressed_crc not in (0, found := zlib.crc32(content)):
                raise ValueError(f"a chunk has the CRC {found:08x}, expected {record.uncompressed_crc:08x}")
            yield from _chunk_records(content)
        else:
            yield record


def _chunk_records(content: bytes) -> Iterator[McapRecord]:
    """Yield the records in an MCAP chunk one by one: mcap's function needs ten times the memory for all at once."""
    place = 0
    while place < len(content):
        if place + RECORD_PREFIX > len(content):
            raise EndOfFile
        opcode, length = _PREFIX_STRUCT.unpack_from(content, place)
        begin, place = place + RECORD_PREFIX, place + RECORD_PREFIX + length
        if place > len(content):
            raise EndOfFile
        if opcode == Opcode.MESSAGE:
            if length < _MESSAGE_STRUCT.size:
                raise ValueError("a message is cut short")
            channel, sequence, logged, published = _MESSAGE_STRUCT.unpack_from(content, begin)
            data = content[begin + _MESSAGE_STRUCT.size : place]
            yield Message(channel_id=channel, sequence=sequence, log_time=logged, publish_time=published, data=data)
        elif opcode in (Opcode.SCHEMA, Opcode.CHANNEL):
            kind = Schema if opcode == Opcode.SCHEMA else Channel
            yield kind.read(ReadDataStream(BytesIO(content[begin:place])))
