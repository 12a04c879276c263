"""Writing of recordings: rows of samples, events and attachments to an MCAP file of protobuf messages.

Message records wait, one block per topic and slice, until they fill a chunk. Then the blocks are merged in order of
time across topics, cut into chunks and indexed (https://mcap.dev/spec#message-index-op0x07). The merge order depends
only on the numbers of messages and the times between them, which repeat slice after slice, so it is cached.
"""

import struct
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass
from functools import lru_cache
from itertools import groupby, pairwise
from pathlib import Path
from types import TracebackType
from typing import NamedTuple, Self

import numpy as np
import zstandard
from foxglove_schemas_protobuf.Log_pb2 import Log
from mcap.opcode import Opcode
from mcap.records import Attachment, AttachmentIndex, Channel, Header, Message, Metadata, MetadataIndex, Schema
from mcap.writer import MCAP0_MAGIC

from twin import __version__
from twin.kernel.compiled.function import carray, copy
from twin.kernel.compiled.native import entry
from twin.kernel.errors import RecordingWriteError
from twin.kernel.recording.folder import Output
from twin.kernel.recording.messages import (
    HEAD_SIZE,
    Filling,
    MessageForm,
    Topic,
    descriptor_set,
    descriptors_of,
    form_filling,
    head_dtype,
    log_message,
    message_layout,
    message_names,
    record_template,
)
from twin.kernel.recording.summary import COMPRESSION_LEVEL, Summary, encode_record, make_chunk

INITIAL_BYTES = 256 * 1024
"""Initial size of the memory of pending messages, enough for one slice (bytes)."""
# chunk size before compression, bytes: small, because the last chunk may be lost; large enough to compress well
MAX_CHUNK_BYTES = 256 * 1024
# size of a log time and an offset in an index, bytes
INDEX_ENTRY_BYTES = 16
MAX_CACHED_ORDERS, MAX_CACHED_MESSAGES = 32, 5000
"""Maximum number of cached merge orders, and of messages in each: a few MB."""
EVENTS_TOPIC = "events"
NS_PER_S = 1e9
# a chunk is closed at the end of the slice in which it reaches this size; before compression, bytes
MIN_CHUNK_BYTES = 64 * 1024


class BlockShape(NamedTuple):
    """Shape of a block of message records: channel, number of messages, and bytes per record."""

    channel: int
    messages: int
    stride: int


class PendingMessages:
    """Message records of several channels that wait for a chunk, block after block, `size` bytes at `address`.

    `times` has the log times of each block, ns, (n,) int64, ascending.
    """

    def __init__(self) -> None:
        self._use_memory(np.empty(INITIAL_BYTES, dtype=np.uint8))
        self.clear()

    def reserve(self, size: int) -> int:
        """Return the address for the next block of message records, with room for at least `size` bytes."""
        if self.size + size > len(self._memory):
            larger = np.empty(2 * (self.size + size), dtype=np.uint8)
            larger[: self.size] = self._memory[: self.size]
            self._use_memory(larger)
        return self.address + self.size

    def add_block(self, channel: int, times: np.ndarray, stride: int) -> None:
        """Register the message records written after `reserve` as a block: `stride` bytes per time."""
        self.shapes.append(BlockShape(channel, len(times), stride))
        self.times.append(times)
        self.size += len(times) * stride

    def append_records(self, channel: int, times: np.ndarray, records: np.ndarray) -> None:
        """Append a block of message records, (n, stride) uint8."""
        self.reserve(records.size)
        self._memory[self.size : self.size + records.size] = records.reshape(-1)
        self.add_block(channel, times, records.shape[1])

    def clear(self) -> None:
        """Remove all blocks of message records; their memory is reused."""
        self.shapes: list[BlockShape] = []
        self.times: list[np.ndarray] = []
        self.size = 0

    def _use_memory(self, memory: np.ndarray) -> None:
        self._memory, self.address = memory, memory.ctypes.data


@dataclass(frozen=True)
class Piece:
    """Consecutive message records that become one chunk. Times are relative to the first of the merged messages.

    `content` is the range of its bytes in the merged records. `start` and `end` are log times of the first and the last
    message, ns. `entries` are log times and offsets in this piece, channel after channel, (n, 2) uint64. `channels` are
    (number, front of its index record, range of its entries in the bytes of `entries`).
    """

    content: slice
    start: int
    end: int
    entries: np.ndarray
    channels: tuple[tuple[int, bytes, slice], ...]

    def indexes(self, begin: int, shift: int) -> dict[int, bytes]:
        """Encode the MCAP MessageIndex records of the chunk, by channel; messages follow `shift` bytes of the chunk.

        `begin` is the log time of the first of the merged messages, ns. Built from arrays: mcap's own MessageIndex
        packs entry by entry and would dominate the cost of writing.
        """
        own = (self.entries + np.array([begin, shift], dtype="<u8")).tobytes()
        return {channel: head + own[where] for channel, head, where in self.channels}


class MergedRecords(NamedTuple):
    """Message records (bytes,) uint8 of several channels in order of time; `begin` is the first log time, ns.

    Pieces are chunks of about `MAX_CHUNK_BYTES` at most, cut between ticks: topics of a truncated file end together.
    """

    begin: int
    content: np.ndarray
    pieces: tuple[Piece, ...]


def merge_by_time(pending: PendingMessages) -> MergedRecords:
    """Merge the message records in `pending`, at least one, in order of time, and clear it."""
    times = np.concatenate(pending.times)
    begin = times.min()
    made = _merge_order if len(times) <= MAX_CACHED_MESSAGES else _merge_order.__wrapped__
    weave = made(tuple(pending.shapes), (times - begin).tobytes())
    content = np.empty(pending.size, dtype=np.uint8)
    _scatter(content, pending.address, *weave.table)
    pending.clear()
    return MergedRecords(int(begin), content, weave.pieces)


@entry("nothing", "int", "int", "integers", "int", "integers", "int")
def _scatter(content, source, blocks, number, places, messages):
    block, place = carray(blocks, 2 * number), carray(places, messages)
    k = 0
    for b in range(number):
        stride = block[2 * b + 1]
        for _ in range(block[2 * b]):
            copy(content + place[k], source, stride)
            source += stride
            k += 1


class _MergeOrder:
    """Order of message records of some blocks, merged by time, in `pieces` as of `MergedRecords`.

    `places` are the destination offsets, block after block, (n,) int64. `table` are arguments of `_scatter`.
    """

    def __init__(self, shapes: Sequence[BlockShape], places: np.ndarray, pieces: tuple[Piece, ...]):
        self.pieces = pieces
        self._blocks, self._places = np.array([shape[1:] for shape in shapes], dtype=np.int64), places
        self.table = self._blocks.ctypes.data, len(shapes), places.ctypes.data, len(places)


@lru_cache(MAX_CACHED_ORDERS)
def _merge_order(shapes: tuple[BlockShape, ...], times: bytes) -> _MergeOrder:
    """Compute the order by time of message blocks whose `times`, (n,) int64, are relative to the first message."""
    counts = [shape.messages for shape in shapes]
    since = np.frombuffer(times, dtype=np.int64)
    order = np.argsort(since, kind="stable")
    since = since[order]
    channels = np.repeat([shape.channel for shape in shapes], counts)[order]
    offsets = np.concatenate([[0], np.cumsum(np.repeat([shape.stride for shape in shapes], counts)[order])])
    places = np.empty(len(since), dtype=np.int64)
    places[order] = offsets[:-1]
    parts = -(-int(offsets[-1]) // MAX_CHUNK_BYTES)
    targets = np.arange(1, parts) * int(offsets[-1]) // parts
    inside = np.searchsorted(offsets, targets, side="right") - 1
    bounds = np.unique([0, *np.searchsorted(since, since[inside]), len(since)])
    pieces = tuple(_piece(since[a:b], channels[a:b], offsets[a : b + 1]) for a, b in pairwise(bounds.tolist()))
    return _MergeOrder(shapes, places, pieces)


def _piece(since: np.ndarray, channels: np.ndarray, offsets: np.ndarray) -> Piece:
    first, last = offsets[[0, -1]].tolist()
    entries = np.stack([since, offsets[:-1] - first], axis=1).astype("<u8")
    numbers, counts = np.unique(channels, return_counts=True)
    sizes = INDEX_ENTRY_BYTES * counts
    ends = np.cumsum(sizes)
    places = tuple(
        (number, struct.pack("<BQHI", Opcode.MESSAGE_INDEX, 6 + size, number, size), slice(end - size, end))
        for number, size, end in zip(numbers.tolist(), sizes.tolist(), ends.tolist(), strict=True)
    )
    in_turn = entries[np.argsort(channels, kind="stable")]
    return Piece(slice(first, last), int(since[0]), int(since[-1]), in_turn, places)


@dataclass
class OpenTopic:
    """State of a topic, with a message every `period` ticks of `width` numbers, while a recording is written.

    `next_tick` is the earliest of its next row, possibly a fraction.
    """

    channel: int
    period: int
    width: int
    filling: Filling
    next_tick: float = 0

    @classmethod
    def from_topic(cls, topic: Topic | MessageForm, channel: int) -> Self:
        """Create the writing state of `topic` on MCAP channel number `channel`."""
        if isinstance(topic, MessageForm):
            return cls(channel, topic.period, topic.width, form_filling(channel, topic))
        width = sum(field.size for field in topic.fields)
        return cls(channel, topic.period, width, message_layout(channel, topic.fields).filling)


@dataclass(frozen=True)
class ForeignTopic:
    """A recorded topic (`/joint_states`) whose messages are stored unchanged, in the encoding of their sender (`cdr`).

    `type_name`, `schema_encoding`, `definition`: `sensor_msgs/msg/JointState`, `ros2msg`, its text.
    """

    name: str
    encoding: str
    type_name: str
    schema_encoding: str
    definition: bytes


class Writer:
    """Writer of a recording (MCAP file): writes `NAME.mcap.partial` and renames it to `NAME.mcap` when finished.

    Times in the file are simulation time from 0, and neither clock nor machine is recorded, so equal input gives equal
    bytes. As a context manager it finishes on a normal exit and abandons on an exception. Every method that writes
    raises RecordingWriteError if the disk is full or the recording is closed.
    """

    def __init__(
        self,
        path: str | Path,
        topics: Sequence[Topic],
        tick: float,
        metadata: Mapping[str, Mapping[str, str]],
        forms: Sequence[MessageForm] = (),
        others: Sequence[ForeignTopic] = (),
    ) -> None:
        """Create the partial file of a recording and write its header and metadata: name -> key -> text.

        `/events` is added to the numeric topics. A tick lasts `tick` s. `forms` are topics for viewers, `others` have
        messages recorded unchanged; `read` skips both. ValueError: two topics of one name, or of different fields whose
        names give one message type, or a form whose example lacks a column.
        """
        streams: list[Topic | MessageForm] = [*topics, *forms]
        names = [stream.name for stream in streams]
        if len({*names, EVENTS_TOPIC}) <= len(names):
            raise ValueError(f"topics {names}: expected different names other than {EVENTS_TOPIC!r}")
        self.tick = tick
        schemas, self._channels = _declare_topics(topics, forms)
        self._topics = {
            stream.name: OpenTopic.from_topic(stream, channel.id)
            for stream, channel in zip(streams, self._channels[:-1], strict=True)
        }
        self._events = self._channels[-1].id
        self._others = _declare_others(others, schemas, self._channels)
        self._summary = Summary(schemas, self._channels)
        self._compressor = zstandard.ZstdCompressor(level=COMPRESSION_LEVEL)
        self._pending = PendingMessages()
        self._slice_topics: set[str] = set()
        self._newest: dict[int, int] = {}
        # most topics have the same times; with their addresses
        self._slice_times: dict[range, tuple[np.ndarray, int]] = {}
        self._output = Output(Path(path))
        self._output.append(MCAP0_MAGIC + encode_record(Header(profile="", library=f"twin {__version__}")))
        for name, entries in metadata.items():
            self.write_metadata(name, entries)

    def write(self, topic: str, first_tick: int, rows: np.ndarray) -> None:
        """Record rows of numbers of `topic`, for the evenly spaced ticks from `first_tick` on, after its rows so far.

        Call once per topic and slice of time; a second call for a topic begins the next slice. Messages of a slice are
        in order of time across topics, at equal times in the order of the calls. Rows are (n, sum of the sizes of the
        topic's fields) float64, columns in the order of the fields; (n, width) for a form.
        """
        opened = self._topics[topic]
        if rows.ndim != 2 or rows.shape[1] != opened.width:
            raise ValueError(f"topic {topic}: rows of shape {rows.shape}, expected (n, {opened.width})")
        if first_tick < opened.next_tick:
            raise ValueError(f"topic {topic}: tick {first_tick} comes after {opened.next_tick - opened.period}")
        if topic in self._slice_topics:
            self.end_slice()
        self._slice_topics.add(topic)
        if not len(rows):
            return
        ticks = range(first_tick, first_tick + opened.period * len(rows), opened.period)
        known = self._slice_times.get(ticks)
        if known is None:
            made = self._times(np.arange(ticks.start, ticks.stop, ticks.step))
            known = self._slice_times[ticks] = made, made.ctypes.data
        self._append_rows(opened, *known, rows)
        opened.next_tick = ticks.stop

    def write_at(self, topic: str, ticks: np.ndarray, rows: np.ndarray) -> None:
        """Record rows of `topic` for `ticks` (n,), ascending not necessarily evenly spaced or whole; see `write`."""
        opened = self._topics[topic]
        if rows.shape != (len(ticks), opened.width):
            raise ValueError(f"topic {topic}: rows of shape {rows.shape}, expected ({len(ticks)}, {opened.width})")
        if topic in self._slice_topics:
            self.end_slice()
        self._slice_topics.add(topic)
        if not len(ticks):
            return
        if ticks[0] < opened.next_tick or np.any(np.diff(ticks) <= 0):
            raise ValueError(f"topic {topic}: ticks that do not ascend, or come before {opened.next_tick}")
        times = self._times(ticks)
        self._append_rows(opened, times, times.ctypes.data, rows)
        opened.next_tick = ticks[-1] + (1 if ticks.dtype.kind == "i" else np.spacing(ticks[-1]))

    def write_messages(self, topic: str, ticks: Sequence[int], messages: Sequence[bytes]) -> None:
        """Record `messages` of a `ForeignTopic` unchanged, each at its tick; see `write_event`."""
        channel, counts = self._others[topic], self._summary.message_counts
        # consecutive messages of equal length make one block
        for size, group in groupby(zip(ticks, messages, strict=True), lambda one: len(one[1])):
            of_tick, contents = zip(*group, strict=True)
            times = self._ascending_times(channel, of_tick)
            records = np.empty((len(times), HEAD_SIZE + size), dtype=np.uint8)
            records[:] = record_template(channel, bytes(size))
            head = records.view(head_dtype(records.shape[1]))[:, 0]
            head["sequence"] = np.arange(counts[channel], counts[channel] + len(times))
            head["log_time"] = head["publish_time"] = times
            records[:, HEAD_SIZE:] = np.frombuffer(b"".join(contents), dtype=np.uint8).reshape(len(times), size)
            counts[channel] += len(times)
            self._pending.append_records(channel, times, records)

    def write_event(self, tick: int, level: str, text: str, name: str) -> None:
        """Record an `Event` at `tick` as a `foxglove.Log` message on `/events`, no earlier than the previous event."""
        channel = self._events
        times = self._ascending_times(channel, [tick])
        time = int(times[0])
        data = log_message(time, level, text, name)
        record = encode_record(Message(channel, time, data, time, self._summary.message_counts[channel]))
        self._summary.message_counts[channel] += 1
        self._pending.append_records(channel, times, np.frombuffer(record, dtype=np.uint8)[None, :])

    def write_metadata(self, name: str, entries: Mapping[str, str]) -> None:
        """Write a metadata record to the recording immediately, before messages still buffered."""
        record = encode_record(Metadata(name, dict(entries)))
        start = self._output.append(record)
        self._summary.metadata.append(MetadataIndex(start, len(record), name))

    def write_attachment(self, name: str, tick: int, media_type: str, content: bytes) -> None:
        """Write an attachment of `tick` to the recording after all buffered messages."""
        self._write_chunks()
        time = int(self._times(np.array([tick]))[0])
        record = encode_record(Attachment(0, time, name, media_type, content))
        start = self._output.append(record)
        self._summary.attachments.append(AttachmentIndex(start, len(record), time, 0, len(content), name, media_type))

    def finish(self) -> Path:
        """Finish the recording: write messages, index and footer, sync, rename and return its path.

        On RecordingWriteError (disk full, recording closed) the partial file stays, readable.
        """
        self._write_chunks()
        self._output.append(self._summary.ending(self._output.size, self._output.crc))
        self._output.publish()
        return self._output.path

    def abandon(self) -> Path:
        """Write buffered messages, close the recording, even if the disk is full, and return its partial path."""
        if not self._output.closed:
            self._write_chunks()
            self._output.close()
        return self._output.partial

    def __enter__(self) -> Self:
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        if error is not None:
            try:
                self.abandon()
            except RecordingWriteError as failure:
                # the first error is the one to report; this one is a consequence of it
                error.add_note(str(failure))
        elif not self._output.closed:
            self.finish()

    def flush(self) -> None:
        """Write all buffered messages of the recording to the file, so that they survive the end of this process."""
        self.end_slice()
        self._write_chunks()

    def _append_rows(self, opened: OpenTopic, times: np.ndarray, times_at: int, rows: np.ndarray) -> None:
        """Append message records of `rows` at `times` (ns), whose address is `times_at`."""
        count, counts, stride = len(rows), self._summary.message_counts, len(opened.filling.template)
        to = self._pending.reserve(count * stride)
        opened.filling.fill(to, times_at, count, counts[opened.channel], rows)
        counts[opened.channel] += count
        self._pending.add_block(opened.channel, times, stride)

    def _times(self, ticks: np.ndarray) -> np.ndarray:
        """Compute the log times of `ticks`, ns, (n,) int64, each from its own tick, so that no errors accumulate."""
        return np.rint(ticks * (self.tick * NS_PER_S)).astype(np.int64)

    def _ascending_times(self, channel: int, ticks: Sequence[int]) -> np.ndarray:
        """Compute ascending log times (ns) for `ticks`, no earlier than the channel's last one."""
        times = np.maximum.accumulate([self._newest.get(channel, 0), *self._times(np.array(ticks)).tolist()])[1:]
        self._newest[channel] = int(times[-1])
        return times

    def end_slice(self) -> None:
        """End the slice of time being written, and write the pending messages if they fill a chunk."""
        self._slice_topics.clear()
        self._slice_times.clear()
        if self._pending.size >= MIN_CHUNK_BYTES:
            self._write_chunks()

    def _write_chunks(self) -> None:
        append_chunks(self._output, self._summary, self._pending, self._compressor)


def append_chunks(
    output: Output, summary: Summary, pending: PendingMessages, compressor: zstandard.ZstdCompressor
) -> None:
    """Write the `pending` messages to the MCAP file as chunks with their indexes, and note them in `summary`.

    A failed write, because the disk is full or the recording is closed, loses the pending messages.
    """
    if not pending.size:
        return
    records = merge_by_time(pending)
    for piece in records.pieces:
        # schemas and channels go into the first chunk rather than before it, so that its CRC covers them
        declared = [*summary.schemas, *summary.channels] if not summary.chunks else []
        preamble = b"".join(map(encode_record, declared))
        messages = records.content.data[piece.content]
        inside = b"".join((preamble, messages)) if preamble else messages
        record = make_chunk(inside, records.begin + piece.start, records.begin + piece.end, compressor)
        data = encode_record(record)
        indexes = piece.indexes(records.begin, len(preamble))
        start = output.append(data + b"".join(indexes.values()))
        summary.note_chunk(record, start, len(data), indexes)


class Declaration(NamedTuple):
    """Declaration of a recorded topic: name, message type, FileDescriptorSet of the type, field -> unit and meaning."""

    topic: str
    type_name: str
    descriptors: bytes
    meanings: dict[str, str]


def declarations(topics: Sequence[Topic], forms: Sequence[MessageForm]) -> Iterator[Declaration]:
    """Yield the declarations of the recorded `topics` and `forms` in their order, and last of `/events`."""
    for topic, name in zip(topics, message_names(topics), strict=True):
        meanings = {field.name: f"{field.unit}; {field.meaning}" for field in topic.fields}
        yield Declaration(topic.name, name, descriptor_set(name, topic.fields), meanings)
    for name, kind in [*((form.name, form.example.DESCRIPTOR) for form in forms), (EVENTS_TOPIC, Log.DESCRIPTOR)]:
        yield Declaration(name, kind.full_name, descriptors_of(kind), {})


def _declare_topics(topics: Sequence[Topic], forms: Sequence[MessageForm]) -> tuple[list[Schema], list[Channel]]:
    """Create the MCAP schemas and channels of all `declarations`; ids count from 1."""
    schemas: dict[str, Schema] = {}
    channels: list[Channel] = []
    for topic, type_name, descriptors, meanings in declarations(topics, forms):
        schema = schemas.setdefault(type_name, Schema(len(schemas) + 1, descriptors, "protobuf", type_name))
        channels.append(Channel(len(channels) + 1, f"/{topic}", "protobuf", meanings, schema.id))
    return list(schemas.values()), channels


def _declare_others(others: Sequence[ForeignTopic], schemas: list[Schema], channels: list[Channel]) -> dict[str, int]:
    """Append MCAP schemas and channels for the topics `others` to the lists; return the channel numbers by topic.

    A topic with the name of one of twin's topics gets `/robot` before its name.
    """
    own, found = {channel.topic for channel in channels}, {}
    for other in others:
        schema = Schema(len(schemas) + 1, other.definition, other.schema_encoding, other.type_name)
        schemas.append(schema)
        name = f"/robot{other.name}" if other.name in own else other.name
        channels.append(Channel(len(channels) + 1, name, other.encoding, {}, schema.id))
        found[other.name] = channels[-1].id
    return found
