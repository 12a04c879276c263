"""Writing a recording: slices of rows in, an MCAP file of protobuf messages out."""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from types import TracebackType
from typing import Self

import numpy as np
import zstandard
from foxglove_schemas_protobuf.Log_pb2 import Log
from mcap.records import Channel, Header, Message, Metadata, MetadataIndex, Schema
from mcap.writer import MCAP0_MAGIC

from twin import __version__
from twin.recording.chunks import COMPRESSION_LEVEL, chunk, encoded
from twin.recording.errors import RecordingFailed
from twin.recording.filling import Filling
from twin.recording.form import Form, form_filling
from twin.recording.layout import Field, Topic
from twin.recording.messages import message_layout, no_integer
from twin.recording.output import Output
from twin.recording.pending import Pending
from twin.recording.schema import descriptor_set, descriptors_of, log_descriptor_set, message_names
from twin.recording.summary import Summary
from twin.recording.weave import woven

EVENTS = "events"
NANOSECONDS = 1e9
# a chunk is closed at the end of the slice in which it reaches this size; before compression, bytes
SMALLEST_CHUNK = 64 * 1024


@dataclass
class OpenTopic:
    """A topic on its way into the file.

    Attributes:
        channel: its number.
        period: ticks from one message to the next.
        width: numbers in a row.
        filling: of its Message records.
        fields: of a numeric topic.
        next_tick: the tick its next row may not precede.
    """

    channel: int
    period: int
    width: int
    filling: Filling
    fields: Sequence[Field]
    next_tick: int = 0


class Writer:
    """Writes `NAME.mcap.partial` and, when finished, renames it to `NAME.mcap`.

    Times in the file are simulation time from 0; neither clock nor machine leaves a trace, so equal input
    gives equal bytes. As a context manager it finishes on a normal exit and abandons on an exception.
    """

    def __init__(
        self,
        path: str | Path,
        topics: Sequence[Topic],
        tick: float,
        metadata: Mapping[str, Mapping[str, str]],
        forms: Sequence[Form] = (),
    ) -> None:
        """Create the partial file and write its header and metadata.

        Args:
            path: of the finished file.
            topics: the numeric topics; `/events` is added to them.
            tick: duration of one tick, s.
            metadata: name -> key -> text, readable in any MCAP tool.
            forms: topics for viewers, which `read` passes over.

        Raises:
            RecordingFailed: the file cannot be created or the disk is full.
            ValueError: two topics of one name, or of different fields whose names give one message type; a form whose
                example lacks a column.
        """
        streams: list[Topic | Form] = [*topics, *forms]
        names = [stream.name for stream in streams]
        if len({*names, EVENTS}) <= len(names):
            raise ValueError(f"topics {names}: expected different names, none of them {EVENTS!r}")
        self.tick = tick
        schemas, self._channels = _declarations(topics, forms)
        self._topics = {
            stream.name: _opened(stream, channel.id)
            for stream, channel in zip(streams, self._channels[:-1], strict=True)
        }
        self._summary = Summary(schemas, self._channels)
        self._compressor = zstandard.ZstdCompressor(level=COMPRESSION_LEVEL)
        self._pending = Pending()
        self._slice_topics: set[str] = set()
        # most topics have the same; with their addresses
        self._slice_times: dict[range, tuple[np.ndarray, int]] = {}
        self._output = Output(Path(path))
        self._output.append(MCAP0_MAGIC + encoded(Header(profile="", library=f"twin {__version__}")))
        for name, entries in metadata.items():
            self.write_metadata(name, entries)

    def write(self, topic: str, first_tick: int, rows: np.ndarray) -> None:
        """Record rows of `topic` for the ticks first_tick, first_tick + period, ...

        Meant to be called once per topic and slice of time; a topic that comes round again opens the next
        slice. Messages of a slice are in order of time across topics, at one time in the order of the calls.

        Args:
            topic: name of a topic, as declared.
            first_tick: of the first row; not before the topic's rows already written.
            rows: (n, sum of the sizes of the topic's fields) float64, columns in the order of the fields; of a form,
                (n, its width).

        Raises:
            RecordingFailed: disk full or recording closed.
            KeyError: a topic that was not declared.
            ValueError: rows of another shape, ticks that run backwards, a count that is not a whole number.
        """
        opened = self._topics[topic]
        if rows.ndim != 2 or rows.shape[1] != opened.width:
            raise ValueError(f"topic {topic}: rows of shape {rows.shape}, expected (n, {opened.width})")
        if first_tick < opened.next_tick:
            raise ValueError(f"topic {topic}: tick {first_tick} comes after {opened.next_tick - opened.period}")
        if topic in self._slice_topics:
            self.end_slice()
        self._slice_topics.add(topic)
        count = len(rows)
        if count == 0:
            return
        ticks = range(first_tick, first_tick + opened.period * count, opened.period)
        known = self._slice_times.get(ticks)
        if known is None:
            made = self._times(np.arange(ticks.start, ticks.stop, ticks.step))
            known = self._slice_times[ticks] = made, made.ctypes.data
        times, times_at = known
        counts, stride = self._summary.message_counts, len(opened.filling.template)
        to = self._pending.room(count * stride)
        if not opened.filling.fill(to, times_at, count, counts[opened.channel], rows):
            raise ValueError(no_integer(opened.fields, rows))
        counts[opened.channel] += count
        self._pending.add(opened.channel, times, stride)
        opened.next_tick = ticks.stop

    def write_event(self, tick: int, level: str, text: str, name: str) -> None:
        """Record what happened at `tick` as a `foxglove.Log` on `/events`.

        Args:
            level, text, name: as of `Event`.

        Raises:
            ValueError: an unknown level.
        """
        times = self._times(np.array([tick]))
        time = int(times[0])
        log = Log(level=Log.Level.Value(level.upper()), message=text, name=name)
        log.timestamp.FromNanoseconds(time)
        channel = self._channels[-1].id
        data = log.SerializeToString(deterministic=True)
        record = encoded(Message(channel, time, data, time, self._summary.message_counts[channel]))
        self._summary.message_counts[channel] += 1
        self._pending.put(channel, times, np.frombuffer(record, dtype=np.uint8)[None, :])

    def write_metadata(self, name: str, entries: Mapping[str, str]) -> None:
        """Write a metadata record at once, ahead of messages still buffered.

        Raises:
            RecordingFailed: disk full or recording closed.
        """
        record = encoded(Metadata(name, dict(entries)))
        start = self._output.append(record)
        self._summary.metadata.append(MetadataIndex(start, len(record), name))

    def finish(self) -> Path:
        """Write what is buffered, the index and the footer; force it to the disk; rename; return the path.

        Raises:
            RecordingFailed: disk full or recording closed; the partial file stays, readable.
        """
        self._write_chunks()
        self._output.append(self._summary.ending(self._output.size, self._output.crc))
        self._output.publish()
        return self._output.path

    def abandon(self) -> Path:
        """Write what is buffered, close the file under its partial name and return that; harmless if closed.

        Raises:
            RecordingFailed: disk full; the file is closed all the same.
        """
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
            except RecordingFailed as failure:
                # the first error is the one to report; this one came of saving its remains
                error.add_note(str(failure))
        elif not self._output.closed:
            self.finish()

    def _times(self, ticks: np.ndarray) -> np.ndarray:
        """Log times of `ticks`, ns, (n,) int64: each from its own tick, so that nothing accumulates."""
        return np.rint(ticks * (self.tick * NANOSECONDS)).astype(np.int64)

    def end_slice(self) -> None:
        """Put what was written into the file if it fills a chunk, rather than when the next slice begins.

        Raises:
            RecordingFailed: disk full or recording closed.
        """
        self._slice_topics.clear()
        self._slice_times.clear()
        if self._pending.size >= SMALLEST_CHUNK:
            self._write_chunks()

    def _write_chunks(self) -> None:
        append_chunks(self._output, self._summary, self._pending, self._compressor)


def append_chunks(output: Output, summary: Summary, pending: Pending, compressor: zstandard.ZstdCompressor) -> None:
    """Put what is `pending` into the file as chunks with their indexes, and note them in `summary`.

    Raises:
        RecordingFailed: disk full or recording closed; nothing is pending any more.
    """
    if not pending.size:
        return
    records = woven(pending)
    for piece in records.pieces:
        # in the first chunk rather than before it, schemas and channels are under its CRC
        declared = [*summary.schemas, *summary.channels] if not summary.chunks else []
        preamble = b"".join(map(encoded, declared))
        messages = records.content.data[piece.content]
        inside = b"".join((preamble, messages)) if preamble else messages
        record = chunk(inside, records.begin + piece.start, records.begin + piece.end, compressor)
        data = encoded(record)
        indexes = piece.indexes(records.begin, len(preamble))
        start = output.append(data + b"".join(indexes.values()))
        summary.note_chunk(record, start, len(data), indexes)


def _opened(topic: Topic | Form, channel: int) -> OpenTopic:
    if isinstance(topic, Form):
        return OpenTopic(channel, topic.period, topic.width, form_filling(channel, topic), ())
    width = sum(field.size for field in topic.fields)
    return OpenTopic(channel, topic.period, width, message_layout(channel, topic.fields).filling, topic.fields)


def _declarations(topics: Sequence[Topic], forms: Sequence[Form]) -> tuple[list[Schema], list[Channel]]:
    """Schemas and channels of `topics` and `forms` in their order, and last those of `/events`; ids count from 1."""
    schemas: dict[str, Schema] = {}
    channels: list[Channel] = []

    def declare(topic: str, type_name: str, descriptors: bytes, metadata: dict[str, str]) -> None:
        schema = schemas.setdefault(type_name, Schema(len(schemas) + 1, descriptors, "protobuf", type_name))
        channels.append(Channel(len(channels) + 1, f"/{topic}", "protobuf", metadata, schema.id))

    for topic, name in zip(topics, message_names(topics), strict=True):
        meanings = {field.name: f"{field.unit}; {field.meaning}" for field in topic.fields}
        declare(topic.name, name, descriptor_set(name, topic.fields), meanings)
    for form in forms:
        declare(form.name, form.example.DESCRIPTOR.full_name, descriptors_of(form.example.DESCRIPTOR), {})
    declare(EVENTS, Log.DESCRIPTOR.full_name, log_descriptor_set(), {})
    return list(schemas.values()), channels
