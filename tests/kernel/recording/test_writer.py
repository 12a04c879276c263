import resource
import tracemalloc
from collections import Counter, defaultdict
from collections.abc import Iterator
from contextlib import contextmanager
from fractions import Fraction
from io import BytesIO
from itertools import pairwise
from pathlib import Path
from typing import NamedTuple

import numpy as np
import pytest
import zstandard
from hypothesis import given
from hypothesis import strategies as st
from mcap.data_stream import ReadDataStream, RecordBuilder
from mcap.exceptions import EndOfFile
from mcap.opcode import Opcode
from mcap.reader import NonSeekingReader, SeekingReader, make_reader
from mcap.records import Chunk, ChunkIndex, MessageIndex
from mcap.stream_reader import StreamReader, get_chunk_data_stream
from mcap_protobuf.decoder import DecoderFactory

from twin.kernel.errors import RecordingDamageError, RecordingWriteError
from twin.kernel.recording.folder import Output
from twin.kernel.recording.messages import Field, Topic
from twin.kernel.recording.reader import attachments, read
from twin.kernel.recording.summary import Summary, make_chunk
from twin.kernel.recording.writer import (
    INITIAL_BYTES,
    MAX_CHUNK_BYTES,
    BlockShape,
    MergedRecords,
    PendingMessages,
    Writer,
    merge_by_time,
)

from . import samples
from .samples import DRIVE, METADATA, TF, TF_ROWS, TICK, TICKS, TOPICS


@contextmanager
def largest_file(size: int) -> Iterator[None]:
    """The kernel lets no file of this process grow beyond `size` bytes: writes come back short, then fail."""
    soft, hard = resource.getrlimit(resource.RLIMIT_FSIZE)
    resource.setrlimit(resource.RLIMIT_FSIZE, (size, hard))
    try:
        yield
    finally:
        resource.setrlimit(resource.RLIMIT_FSIZE, (soft, hard))


@pytest.mark.parametrize("share", [0.1, 0.5, 0.9])
def test_a_recording_that_may_not_grow_says_so_and_keeps_its_complete_chunks(
    share: float, unfinished: Path, tmp_path: Path, truth: dict[str, np.ndarray]
) -> None:
    limit = int(share * unfinished.stat().st_size)
    with (
        largest_file(limit),
        pytest.raises(RecordingWriteError, match=r"run\.mcap\.partial: recording stopped: File too large; the "),
        Writer(tmp_path / "run.mcap", TOPICS, TICK, METADATA, [TF]) as writer,
    ):
        samples.fill(writer)
    recording = read(tmp_path / "run.mcap.partial")
    samples.assert_beginning(recording, truth)
    assert recording.streams if share > 0.2 else True
    # cut back to its last complete record, the file has nothing after it
    assert recording.note.endswith("0 bytes after that are incomplete")


def test_a_recording_that_fails_at_its_index_keeps_every_row(
    unfinished: Path, tmp_path: Path, truth: dict[str, np.ndarray]
) -> None:
    with (
        largest_file(unfinished.stat().st_size + 10),
        pytest.raises(RecordingWriteError, match="File too large"),
        Writer(tmp_path / "run.mcap", TOPICS, TICK, METADATA, [TF]) as writer,
    ):
        samples.fill(writer)
    recording = read(tmp_path / "run.mcap.partial")
    samples.assert_beginning(recording, truth)
    assert len(recording["plant.p_B"]) == samples.TICKS


def test_a_full_disk_is_named_in_one_sentence(tmp_path: Path) -> None:
    (tmp_path / "run.mcap.partial").symlink_to("/dev/full")
    with pytest.raises(RecordingWriteError) as caught:
        Writer(tmp_path / "run.mcap", TOPICS, TICK, METADATA, [TF])
    path = tmp_path / "run.mcap.partial"
    assert str(caught.value) == (
        f"{path}: recording stopped: No space left on device; the 0 bytes already written stay readable"
    )
    assert caught.value.exit_code == 3


def test_a_folder_that_does_not_exist_is_named(tmp_path: Path) -> None:
    with pytest.raises(RecordingWriteError, match=r"nowhere/run\.mcap\.partial: cannot be created: No such file"):
        Writer(tmp_path / "nowhere" / "run.mcap", TOPICS, TICK, METADATA, [TF])


def test_the_error_that_stopped_the_run_is_not_hidden_by_the_disk(tmp_path: Path) -> None:
    with (
        largest_file(2000),
        pytest.raises(ZeroDivisionError) as caught,
        Writer(tmp_path / "run.mcap", TOPICS, TICK, METADATA, [TF]) as writer,
    ):
        writer.write("drive/1", 0, np.random.default_rng(0).normal(size=(500, 2)))
        raise ZeroDivisionError
    assert "recording stopped: File too large" in caught.value.__notes__[0]


def test_an_interrupt_halfway_through_a_record_leaves_no_half_record(tmp_path: Path) -> None:
    class Interrupting:
        """A file that is interrupted after it has written a part."""

        def __init__(self, output: Output) -> None:
            assert output._file is not None
            self.file = output._file

        def write(self, data: bytes) -> int:
            self.file.write(data[:3])
            raise KeyboardInterrupt

        def __getattr__(self, name: str) -> object:
            return getattr(self.file, name)

    output = Output(tmp_path / "run.mcap")
    output.append(b"whole")
    output._file = Interrupting(output)  # type: ignore[assignment]
    with pytest.raises(KeyboardInterrupt):
        output.append(b"interrupted")
    assert output.partial.read_bytes() == b"whole"
    assert output.closed


@given(st.lists(st.integers(1, 2 * INITIAL_BYTES), min_size=1, max_size=6))
def test_its_memory_grows_and_keeps_what_is_in_it(lengths: list[int]) -> None:
    pending = PendingMessages()
    records = [np.full((1, length), number, dtype=np.uint8) for number, length in enumerate(lengths)]
    for number, record in enumerate(records):
        pending.append_records(number, np.array([number]), record)
    assert pending.shapes == [BlockShape(number, 1, length) for number, length in enumerate(lengths)]
    assert pending.size == sum(lengths)
    assert merge_by_time(pending).content.tobytes() == b"".join(record.tobytes() for record in records)


def test_what_was_woven_is_not_there_a_second_time() -> None:
    pending = PendingMessages()
    pending.append_records(1, np.array([5]), np.zeros((1, 40), dtype=np.uint8))
    merge_by_time(pending)
    assert (pending.size, pending.shapes, pending.times) == (0, [], [])


def test_room_that_nobody_adds_to_is_given_again() -> None:
    pending = PendingMessages()
    at = pending.reserve(100)
    assert pending.reserve(10) == at
    assert pending.size == 0


class Block(NamedTuple):
    """Records (n, stride) of one channel, and their times (n,)."""

    channel: int
    times: np.ndarray
    records: np.ndarray


def together(several: list[Block]) -> MergedRecords:
    pending = PendingMessages()
    for block in several:
        pending.append_records(*block)
    return merge_by_time(pending)


@st.composite
def blocks(draw: st.DrawFn) -> Block:
    """Records that name their channel, time and place, so that each can be told from all others."""
    channel = draw(st.integers(1, 5))
    times = np.array(sorted(draw(st.lists(st.integers(0, 20), min_size=1, max_size=8))))
    stride = draw(st.integers(3, 40))
    records = np.zeros((len(times), stride), dtype=np.uint8)
    records[:, 0], records[:, 1], records[:, 2] = channel, times, np.arange(len(times))
    return Block(channel, times, records)


def in_order(several: list[Block]) -> list[tuple[int, int, bytes]]:
    """(time, channel, record) of all messages, by time, then by block."""
    found = [
        (int(time), block.channel, bytes(record))
        for block in several
        for time, record in zip(block.times, block.records, strict=True)
    ]
    return sorted(found, key=lambda message: message[0])


@given(st.lists(blocks(), min_size=1, max_size=6))
def test_weaving_orders_records_by_time_then_by_block_and_loses_none(several: list[Block]) -> None:
    weave, expected = together(several), in_order(several)
    assert weave.content.tobytes() == b"".join(record for _, _, record in expected)
    assert weave.begin == expected[0][0]


@given(st.lists(blocks(), min_size=1, max_size=6), st.integers(1, 10**15), st.integers(1, 255))
def test_what_is_remembered_of_one_slice_fits_the_next(several: list[Block], later: int, mark: int) -> None:
    """Of the same shape, but at other times and with other numbers in it."""
    together(several)
    following = [Block(b.channel, b.times + later, b.records ^ np.uint8(mark)) for b in several]
    weave, expected = together(following), in_order(following)
    assert weave.content.tobytes() == b"".join(record for _, _, record in expected)
    assert (weave.begin, weave.begin + weave.pieces[-1].end) == (expected[0][0], expected[-1][0])


# mostly several pieces: 10 to 60 records of up to 100 kB
@given(st.lists(st.integers(1, 100_000), min_size=10, max_size=60), st.integers(1, 7))
def test_pieces_are_the_whole_in_order_and_never_cut_a_tick(lengths: list[int], per_tick: int) -> None:
    several = [
        Block(1, np.array([k // per_tick]), np.zeros((1, length), dtype=np.uint8)) for k, length in enumerate(lengths)
    ]
    pieces = together(several).pieces
    bounds = [0, *np.cumsum(lengths).tolist()]
    assert [piece.content.start for piece in pieces] == [0, *(piece.content.stop for piece in pieces[:-1])]
    assert pieces[-1].content.stop == bounds[-1]
    assert all(piece.content.start in bounds for piece in pieces)
    assert all(before.end < after.start for before, after in pairwise(pieces))
    # a cut moves back to the start of its tick, which adds at most one tick to the piece after it
    longest = MAX_CHUNK_BYTES + per_tick * max(lengths)
    assert all(piece.content.stop - piece.content.start <= longest for piece in pieces)


@given(st.lists(blocks(), min_size=1, max_size=6), st.integers(0, 1000))
def test_message_indexes_are_those_that_mcap_writes(several: list[Block], shift: int) -> None:
    weave, expected = together(several), in_order(several)
    (piece,) = weave.pieces
    starts = np.cumsum([shift, *(len(record) for _, _, record in expected)]).tolist()
    indexes = piece.indexes(weave.begin, shift)
    assert set(indexes) == {channel for _, channel, _ in expected}
    for channel, index in indexes.items():
        builder = RecordBuilder()
        entries = [(time, start) for (time, own, _), start in zip(expected, starts, strict=False) if own == channel]
        MessageIndex(channel, entries).write(builder)
        assert index == builder.end()


@given(st.lists(st.integers(40_000, 100_000), min_size=10, max_size=30))
def test_indexes_of_a_later_piece_count_from_its_own_first_byte(lengths: list[int]) -> None:
    """A chunk is decompressed by itself: where it begins in the weave does not matter to its index."""
    several = [Block(1, np.array([k]), np.full((1, length), k, dtype=np.uint8)) for k, length in enumerate(lengths)]
    weave = together(several)
    assert len(weave.pieces) > 1
    for piece in weave.pieces:
        chunk = weave.content[piece.content]
        numbers, starts = np.unique(chunk, return_index=True)
        builder = RecordBuilder()
        MessageIndex(1, list(zip(numbers.tolist(), starts.tolist(), strict=True))).write(builder)
        assert piece.indexes(weave.begin, 0) == {1: builder.end()}


def decoded(reader: SeekingReader | NonSeekingReader) -> dict[str, np.ndarray]:
    """`topic.field` -> values of the numeric topics as mcap and protobuf, not twin, read them."""
    values = defaultdict(list)
    for _, channel, _, message in reader.iter_decoded_messages():
        if channel.topic not in ("/events", "/tf"):
            for name, field in message.DESCRIPTOR.fields_by_name.items():
                value = getattr(message, name)
                values[f"{channel.topic[1:]}.{name}"].append(list(value) if field.is_repeated else value)
    return {key: np.array(series) for key, series in values.items()}


def test_another_reader_with_crcs_on_finds_every_value(finished: Path, truth: dict[str, np.ndarray]) -> None:
    with finished.open("rb") as file:
        found = decoded(SeekingReader(file, validate_crcs=True, decoder_factories=[DecoderFactory()]))
    assert found.keys() == truth.keys()
    for key, values in truth.items():
        np.testing.assert_array_equal(found[key], values, strict=True)


def test_another_reader_accepts_the_crc_over_the_whole_data_section(finished: Path) -> None:
    with finished.open("rb") as file:
        messages = sum(1 for _ in NonSeekingReader(file, validate_crcs=True).iter_messages())
    assert messages == sum(len(samples.rows_of(topic)) for topic in TOPICS) + len(TF_ROWS) + 2


def test_an_abandoned_recording_streams_into_another_reader_to_its_last_row(
    unfinished: Path, truth: dict[str, np.ndarray]
) -> None:
    found: list[list[float]] = []
    with unfinished.open("rb") as file:
        reader = NonSeekingReader(file, validate_crcs=True, decoder_factories=[DecoderFactory()])
        # having no footer, the stream ends in an error after all that was written
        with pytest.raises(EndOfFile):
            for _, channel, _, message in reader.iter_decoded_messages(log_time_order=False):
                if channel.topic == "/plant":
                    found.append(list(message.p_B))
    np.testing.assert_array_equal(np.array(found), truth["plant.p_B"])


def test_messages_are_in_order_of_time_and_numbered_without_gaps_on_each_channel(finished: Path) -> None:
    numbers = defaultdict(list)
    times = []
    with finished.open("rb") as file:
        for _, channel, message in NonSeekingReader(file).iter_messages(log_time_order=False):
            numbers[channel.topic].append(message.sequence)
            if channel.topic != "/events":
                times.append(message.log_time)
            assert message.publish_time == message.log_time
    assert all(own == list(range(len(own))) for own in numbers.values())
    assert all(before <= after for before, after in pairwise(times))


def test_the_statistics_count_what_is_there(finished: Path) -> None:
    with finished.open("rb") as file:
        summary = make_reader(file).get_summary()
        file.seek(0)
        found = Counter(channel.topic for _, channel, _ in NonSeekingReader(file).iter_messages())
        file.seek(0)
        chunks = sum(isinstance(r, Chunk) for r in StreamReader(file, emit_chunks=True).records)
    assert summary is not None and summary.statistics is not None
    statistics = summary.statistics
    by_topic = {summary.channels[c].topic: n for c, n in statistics.channel_message_counts.items()}
    assert by_topic == found
    assert statistics.message_count == found.total()
    assert statistics.chunk_count == chunks == len(summary.chunk_indexes)
    assert (statistics.message_start_time, statistics.message_end_time) == (0, (TICKS - 1) * 1_000_000)
    assert statistics.metadata_count == len(summary.metadata_indexes) == 3
    assert (statistics.channel_count, statistics.schema_count) == (len(TOPICS) + 2, 6)
    assert statistics.attachment_count == 0


def test_each_chunk_index_leads_to_its_chunk_and_each_message_index_to_its_messages(finished: Path) -> None:
    with finished.open("rb") as file:
        summary = make_reader(file).get_summary()
        assert summary is not None
        for index in summary.chunk_indexes:
            file.seek(index.chunk_start_offset)
            chunk = next(iter(StreamReader(file, skip_magic=True, emit_chunks=True).records))
            assert isinstance(chunk, Chunk)
            assert file.tell() == index.chunk_start_offset + index.chunk_length
            assert len(chunk.data) == index.compressed_size
            assert (chunk.message_start_time, chunk.message_end_time) == (
                index.message_start_time,
                index.message_end_time,
            )
            ends = file.tell() + index.message_index_length
            assert all(file.tell() <= offset < ends for offset in index.message_index_offsets.values())
            for offset in index.message_index_offsets.values():
                file.seek(offset)
                messages = next(iter(StreamReader(file, skip_magic=True).records))
                assert isinstance(messages, MessageIndex)
                content, _ = get_chunk_data_stream(chunk)
                found = {entry: time for time, entry in messages.records}
                while content.count < chunk.uncompressed_size:
                    start = content.count
                    opcode, length = content.read1(), content.read8()
                    body = content.read(length)
                    if start in found:
                        assert opcode == Opcode.MESSAGE
                        assert int.from_bytes(body[:2], "little") == messages.channel_id
                        assert int.from_bytes(body[6:14], "little") == found.pop(start)
                assert not found


def test_chunks_have_64_to_256_kilobytes(finished: Path) -> None:
    with finished.open("rb") as file:
        summary = make_reader(file).get_summary()
    assert summary is not None
    sizes = [index.uncompressed_size for index in summary.chunk_indexes]
    assert len(sizes) > 3
    # the last one holds what was left
    assert all(64 * 1024 <= size <= 256 * 1024 for size in sizes[:-1])


def test_one_long_slice_is_cut_into_chunks_of_at_most_256_kilobytes(tmp_path: Path) -> None:
    topic = Topic("drive/1", DRIVE, 1)
    with Writer(tmp_path / "long.mcap", [topic], TICK, {}) as writer:
        writer.write("drive/1", 0, np.zeros((20_000, 2)))
    with (tmp_path / "long.mcap").open("rb") as file:
        summary = make_reader(file).get_summary()
    assert summary is not None
    # the first chunk also holds the schemas, which are not counted
    assert max(index.uncompressed_size for index in summary.chunk_indexes[1:]) <= 256 * 1024


def test_equal_input_gives_equal_bytes_wherever_it_is_written(finished: Path, tmp_path: Path) -> None:
    again = samples.finished(tmp_path / "elsewhere.mcap")
    assert again.read_bytes() == finished.read_bytes()


def test_rows_may_be_written_over_as_soon_as_they_are_taken(tmp_path: Path) -> None:
    rows = np.ones((5000, 2))
    with Writer(tmp_path / "run.mcap", [Topic("drive/1", DRIVE, 1)], TICK, {}) as writer:
        writer.write("drive/1", 0, rows)
        rows[:] = 2.0
        writer.end_slice()
        rows[:] = 3.0
    assert (read(tmp_path / "run.mcap")["drive/1.theta_m"] == 1.0).all()


def test_a_recording_names_neither_its_file_nor_any_folder(finished: Path) -> None:
    content = finished.read_bytes()
    assert not [trace for trace in (Path.home(), Path.cwd(), finished.stem) if str(trace).encode() in content]


def test_the_file_says_who_wrote_it(finished: Path) -> None:
    with finished.open("rb") as file:
        header = make_reader(file).get_header()
    assert (header.profile, header.library.split()[0]) == ("", "twin")


@pytest.mark.parametrize("tick", [Fraction(1, 1000), Fraction(1, 3000), Fraction(1, 70_000)])
def test_log_times_are_the_nearest_nanosecond_to_whole_ticks_however_late(tick: Fraction, tmp_path: Path) -> None:
    ticks = 10**7 + np.arange(0, 300, 3)
    with Writer(tmp_path / "late.mcap", [Topic("drive/1", DRIVE, 3)], float(tick), {}) as writer:
        writer.write("drive/1", int(ticks[0]), np.zeros((100, 2)))
    with (tmp_path / "late.mcap").open("rb") as file:
        times = [message.log_time for _, _, message in make_reader(file).iter_messages()]
    assert times == [round(int(k) * tick * 10**9) for k in ticks]


def test_every_channel_has_a_schema_and_tells_unit_and_meaning(finished: Path) -> None:
    with finished.open("rb") as file:
        summary = make_reader(file).get_summary()
    assert summary is not None
    # readers take schema 0 for none
    assert 0 not in {channel.schema_id for channel in summary.channels.values()}
    channels = {channel.topic: channel for channel in summary.channels.values()}
    assert channels["/drive/2"].metadata == {"theta_m": "rad; motor angle", "omega_m": "rad/s; motor speed"}
    assert summary.schemas[channels["/events"].schema_id].name == "foxglove.Log"


def test_events_are_foxglove_logs_at_their_tick(finished: Path) -> None:
    with finished.open("rb") as file:
        reader = make_reader(file, decoder_factories=[DecoderFactory()])
        logs = [(m.log_time, log) for _, _, m, log in reader.iter_decoded_messages("/events")]
    time, log = logs[0]
    assert time == log.timestamp.ToNanoseconds() == 750_000_000
    assert (log.level, log.message, log.name) == (2, "the trigger fired", "controller")


def test_a_recording_has_its_name_only_when_it_is_finished(tmp_path: Path) -> None:
    path, partial = tmp_path / "run.mcap", tmp_path / "run.mcap.partial"
    with Writer(path, TOPICS, TICK, {}, [TF]):
        assert (path.exists(), partial.exists()) == (False, True)
    assert (path.exists(), partial.exists()) == (True, False)


def test_an_exception_leaves_all_rows_in_a_readable_partial_file(tmp_path: Path, truth: dict[str, np.ndarray]) -> None:
    with pytest.raises(ZeroDivisionError), Writer(tmp_path / "run.mcap", TOPICS, TICK, {}, [TF]) as writer:
        samples.fill(writer)
        raise ZeroDivisionError
    assert not (tmp_path / "run.mcap").exists()
    recording = read(tmp_path / "run.mcap.partial")
    samples.assert_beginning(recording, truth)
    assert len(recording["plant.p_B"]) == TICKS


def test_a_closed_recording_takes_no_more(tmp_path: Path) -> None:
    writer = Writer(tmp_path / "run.mcap", TOPICS, TICK, {}, [TF])
    writer.finish()
    with pytest.raises(RecordingWriteError, match="the recording is closed"):
        writer.write_metadata("outcome", {})
    with pytest.raises(RecordingWriteError, match="the recording is closed"):
        writer.finish()
    writer.abandon()
    assert read(tmp_path / "run.mcap").complete


@pytest.mark.parametrize("shape", [(5,), (5, 1), (5, 3)])
def test_rows_of_another_width_than_the_fields_are_refused(shape: tuple[int, ...], tmp_path: Path) -> None:
    writer = Writer(tmp_path / "run.mcap", [Topic("drive/1", DRIVE, 1)], TICK, {})
    with pytest.raises(ValueError, match=r"topic drive/1: rows of shape .* expected \(n, 2\)"):
        writer.write("drive/1", 0, np.zeros(shape))
    writer.abandon()


def test_ticks_never_run_backwards(tmp_path: Path) -> None:
    writer = Writer(tmp_path / "run.mcap", [Topic("drive/1", DRIVE, 2)], TICK, {})
    writer.write("drive/1", 10, np.zeros((3, 2)))
    with pytest.raises(ValueError, match="topic drive/1: tick 14 comes after 14"):
        writer.write("drive/1", 14, np.zeros((3, 2)))
    writer.abandon()


def test_rows_refused_for_a_bad_count_leave_no_gap(tmp_path: Path) -> None:
    path = tmp_path / "run.mcap"
    count = Topic("encoder", (Field("count_m", 1, "int", "1", "motor encoder"),), 1)
    with Writer(path, [count], TICK, {}) as writer:
        with pytest.raises(ValueError, match="whole numbers"):
            writer.write("encoder", 0, np.array([[0.5]]))
        writer.write("encoder", 0, np.array([[1.0]]))
    assert read(path)["encoder.count_m"].tolist() == [1]


def test_topics_need_names_of_their_own(tmp_path: Path) -> None:
    for names in (["a", "a"], ["events"], ["tf"]):
        with pytest.raises(ValueError, match="expected different names"):
            Writer(tmp_path / "run.mcap", [Topic(name, DRIVE, 1) for name in names], TICK, {}, [samples.TF])


KIND, FIRST = "application/x-something", next(topic for topic in TOPICS if topic.period == 1)


@pytest.fixture
def attached(tmp_path: Path) -> Path:
    """A recording with an attachment in the middle, one at the end and one of another kind."""
    with Writer(tmp_path / "attached.mcap", TOPICS, TICK, METADATA) as writer:
        writer.write(FIRST.name, 0, samples.rows_of(FIRST)[:50])
        writer.write_attachment("first", 50, KIND, b"in the middle")
        writer.write(FIRST.name, 50, samples.rows_of(FIRST)[50:])
        writer.write_attachment("other", 60, "text/plain", b"of another kind")
        writer.write_attachment("last", TICKS, KIND, b"at the end")
    return tmp_path / "attached.mcap"


def test_an_attachment_stands_where_it_was_written_and_other_readers_find_it(attached: Path):
    with attached.open("rb") as file:
        found = list(make_reader(file).iter_attachments())
    assert [(one.name, one.media_type, one.data) for one in found] == [
        ("first", KIND, b"in the middle"), ("other", "text/plain", b"of another kind"), ("last", KIND, b"at the end"),
    ]  # fmt: skip
    assert [content for _, content in attachments(attached, KIND)] == [b"in the middle", b"at the end"]
    assert [time for time, _ in attachments(attached, KIND)] == pytest.approx([50 * TICK, TICKS * TICK])
    # what was written before an attachment is in the file before it
    whole = attached.read_bytes()
    cut = attached.with_name("cut.mcap.partial")
    cut.write_bytes(whole[: whole.index(b"in the middle") + 17])
    assert len(read(cut).time(FIRST.name)) == 50 and len(list(attachments(cut, KIND))) == 1


def test_an_attachment_that_was_changed_is_passed_over_and_damages_the_recording(attached: Path):
    content = attached.read_bytes()
    attached.write_bytes(content.replace(b"in the middle", b"in the muddle"))
    assert [content for _, content in attachments(attached, KIND)] == [b"at the end"]
    with pytest.raises(RecordingDamageError, match="a record that does not parse"):
        read(attached)


def test_what_is_remembered_of_a_chunk_does_not_grow_with_the_number_of_topics():
    indexes = {channel: bytes(31 + 16 * (channel % 3)) for channel in range(1, 1001)}
    one = make_chunk(b"content", 0, 10, zstandard.ZstdCompressor())
    summary = Summary([], [])
    tracemalloc.start()
    for number in range(500):
        summary.note_chunk(one, 1000 * number, 100, indexes)
    grown, _ = tracemalloc.get_traced_memory()
    tracemalloc.stop()
    # a layout once; of each chunk numbers alone, where 1000 offsets take 80 kB
    assert grown < 500 * 1000
    # opcode and length before it
    last = ChunkIndex.read(ReadDataStream(BytesIO(list(summary.ending(0, 0))[-2][9:])))
    assert (last.chunk_start_offset, last.message_index_length) == (499_000, sum(map(len, indexes.values())))
    assert [*last.message_index_offsets.items()][:2] == [(1, 499_100), (2, 499_100 + len(indexes[1]))]
