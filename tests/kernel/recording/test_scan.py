"""Cut and damaged files: what is read is what was written, and everything else is refused or named."""

import struct
from collections.abc import Callable
from pathlib import Path

import numpy as np
import pytest
from hypothesis import example, given
from hypothesis import strategies as st
from mcap.opcode import Opcode
from mcap.records import Chunk
from mcap.stream_reader import StreamReader

from tests.kernel.recording.forgery import FRONT, joined
from twin.kernel.errors import RecordingDamageError, RecordingError
from twin.kernel.recording.reader import Recording, read
from twin.kernel.recording.scan import (
    CHANNEL_COLUMN,
    LENGTH_COLUMN,
    OPCODE_COLUMN,
    PLACE_COLUMN,
    SEQUENCE_COLUMN,
    Records,
)

from .samples import METADATA, assert_beginning

messages = st.tuples(st.integers(0, 3), st.integers(0, 2**32 - 1), st.binary(max_size=40)).map(
    lambda m: (int(Opcode.MESSAGE), struct.pack("<HIQQ", m[0], m[1], 0, 0) + m[2])
)
others = st.tuples(st.sampled_from([int(Opcode.SCHEMA), int(Opcode.CHANNEL), 200]), st.binary(max_size=40))
record_lists = st.lists(st.one_of(messages, others), max_size=20)


@given(record_lists)
def test_every_record_is_found_where_it_is(written):
    content = joined(written)
    table = Records(content).table
    assert len(table) == len(written)
    for row, (opcode, body) in zip(table, written, strict=True):
        assert (row[OPCODE_COLUMN], row[LENGTH_COLUMN]) == (opcode, len(body))
        assert content[row[PLACE_COLUMN] + FRONT.size : row[PLACE_COLUMN] + FRONT.size + row[LENGTH_COLUMN]] == body
        expected = struct.unpack_from("<HI", body) if opcode == Opcode.MESSAGE else (-1, -1)
        assert (row[CHANNEL_COLUMN], row[SEQUENCE_COLUMN]) == expected


@given(record_lists, st.integers(1, 60))
def test_bytes_that_end_within_a_record_are_refused(written, lacking):
    content = joined(written)
    ends = {0, *np.cumsum([FRONT.size + len(body) for _, body in written]).tolist()}
    if len(content) - lacking > 0 and len(content) - lacking not in ends:
        with pytest.raises(ValueError, match="longer than its chunk"):
            Records(content[:-lacking])


@pytest.mark.parametrize("length", [12, 2**62, 2**63, 2**64 - 1])
def test_a_length_beyond_the_bytes_is_refused_however_large(length):
    with pytest.raises(ValueError, match="longer than its chunk"):
        Records(struct.pack("<BQ", Opcode.MESSAGE, length) + bytes(11))


def test_the_messages_of_a_channel_are_gathered_if_they_count_on_and_have_one_length():
    def message(channel, sequence, more=b"12345678"):
        return int(Opcode.MESSAGE), struct.pack("<HIQQ", channel, sequence, 0, 0) + more

    written = [message(1, 7), message(2, 0), message(1, 8)]
    stride = FRONT.size + len(written[0][1])
    found = Records(joined(written)).channel_records(1, 2, 7, stride)
    assert found is not None and found.tobytes() == joined([written[0], written[2]])
    assert Records(joined(written)).channel_records(1, 2, 6, stride) is None
    assert Records(joined([message(1, 7), message(1, 9)])).channel_records(1, 2, 7, stride) is None
    with pytest.raises(ValueError, match="length"):
        Records(joined([message(1, 7), message(1, 8, b"1")])).channel_records(1, 2, 7, stride)


Truth = dict[str, np.ndarray]
Altered = Callable[[bytes], Path]
share = st.floats(0, 1, exclude_max=True)


@pytest.fixture(scope="session")
def altered(tmp_path_factory: pytest.TempPathFactory) -> Altered:
    """A function that writes bytes to a file and returns its path."""
    path = tmp_path_factory.mktemp("altered") / "sample.mcap"

    def written(content: bytes) -> Path:
        path.write_bytes(content)
        return path

    return written


@pytest.fixture(scope="session")
def chunk_spans(finished: Path) -> list[tuple[int, int]]:
    """First byte of each chunk record of the finished recording, and first byte after it."""
    spans = []
    with finished.open("rb") as file:
        start = 8
        for record in StreamReader(file, emit_chunks=True).records:
            if isinstance(record, Chunk):
                spans.append((start, file.tell()))
            start = file.tell()
    return spans


def flipped(content: bytes, position: int, mask: int) -> bytes:
    changed = bytearray(content)
    changed[position] ^= mask
    return bytes(changed)


def test_a_file_of_nothing_but_its_first_bytes_is_unfinished_although_it_ends_as_it_begins(
    finished: Path, altered: Altered
) -> None:
    recording = read(altered(finished.read_bytes()[:8]))
    assert recording.note.startswith("unfinished recording: read up to its metadata, no chunk is complete")


@given(share)
def test_a_file_cut_anywhere_reads_to_its_last_complete_chunk(
    finished: Path, truth: Truth, altered: Altered, chunk_spans: list[tuple[int, int]], share: float
) -> None:
    content = finished.read_bytes()
    cut = int(share * len(content))
    path = altered(content[:cut])
    if cut < 8:
        with pytest.raises(RecordingError, match=r"not an MCAP file|an empty file"):
            read(path)
        return
    recording = read(path)
    assert_beginning(recording, truth)
    assert not recording.complete
    whole_chunks = sum(end <= cut for _, end in chunk_spans)
    with finished.open("rb") as file:
        chunks = [r for r in StreamReader(file, emit_chunks=True).records if isinstance(r, Chunk)]
    if whole_chunks:
        reached = chunks[whole_chunks - 1].message_end_time / 1e9
        assert recording.time("plant")[-1] == reached
        extent = f"up to {reached:.3f} s, its last complete chunk"
    else:
        extent = "up to its metadata, no chunk is complete"
    assert recording.note.startswith(f"unfinished recording: read {extent}; ")


def test_a_file_cut_at_any_byte_of_its_ending_reads_whole(finished: Path, truth: Truth, altered: Altered) -> None:
    content = finished.read_bytes()
    # footer and magic have 37 bytes; further in, the cut goes through the index
    for missing in range(1, 60):
        recording = read(altered(content[:-missing]))
        assert_beginning(recording, truth)
        assert len(recording["plant.p_B"]) == 1500
        assert not recording.complete


@given(share, st.integers(1, 255))
# the first and the last byte: both magics
@example(0.0, 1)
@example(1 - 1e-9, 1)
def test_a_changed_byte_of_a_finished_file_is_always_noticed(
    finished: Path, truth: Truth, altered: Altered, share: float, mask: int
) -> None:
    content = finished.read_bytes()
    position = int(share * len(content))
    path = altered(flipped(content, position, mask))
    if position >= len(content) - 8:
        # without its closing magic it is like a file that was cut there
        assert not read(path).complete
        return
    with pytest.raises(RecordingError) as caught:
        read(path)
    if position >= 8:
        assert isinstance(caught.value, RecordingDamageError)
        recording = read(path, salvage=True)
        assert_beginning(recording, truth)
        assert (recording.complete, recording.note[:16]) == (False, "damaged at byte ")


@given(st.lists(st.tuples(share, st.integers(1, 255)), min_size=1, max_size=4), share)
def test_changed_bytes_of_an_unfinished_file_never_change_what_is_read_from_its_chunks(
    unfinished: Path, truth: Truth, altered: Altered, changes: list[tuple[float, int]], share: float
) -> None:
    content = unfinished.read_bytes()[: max(1, int(share * unfinished.stat().st_size))]
    for place, mask in changes:
        content = flipped(content, int(place * len(content)), mask)
    path = altered(content)
    try:
        recording: Recording = read(path)
    except RecordingDamageError:
        recording = read(path, salvage=True)
    except RecordingError:
        assert content[:8] != unfinished.read_bytes()[:8]
        return
    assert_beginning(recording, truth)


@given(st.data())
def test_a_changed_byte_in_the_front_of_any_record_never_changes_what_is_read(
    unfinished: Path, truth: Truth, altered: Altered, data: st.DataObject
) -> None:
    content = unfinished.read_bytes()
    fronts = [8]
    while fronts[-1] < len(content):
        fronts.append(fronts[-1] + 9 + int.from_bytes(content[fronts[-1] + 1 :][:8], "little"))
    # opcode and length are under no CRC, and neither are the times, sizes and CRC at the front of a chunk
    position = data.draw(st.sampled_from(fronts[:-1])) + data.draw(st.integers(0, 50))
    path = altered(flipped(content, min(position, len(content) - 1), data.draw(st.integers(1, 255))))
    try:
        recording = read(path)
    except RecordingDamageError:
        recording = read(path, salvage=True)
    assert_beginning(recording, truth)


def test_a_damaged_chunk_is_located_and_what_precedes_it_survives(
    finished: Path, truth: Truth, altered: Altered, chunk_spans: list[tuple[int, int]]
) -> None:
    start, end = chunk_spans[2]
    path = altered(flipped(finished.read_bytes(), end - 100, 1))
    with finished.open("rb") as file:
        chunks = [r for r in StreamReader(file, emit_chunks=True).records if isinstance(r, Chunk)]
    reached = chunks[1].message_end_time / 1e9
    with pytest.raises(RecordingDamageError) as caught:
        read(path)
    assert f"{path}: damaged at byte {start}: a chunk that " in str(caught.value)
    assert str(caught.value).endswith(f"; with salvage it can be read up to {reached:.3f} s, its last complete chunk")
    recording = read(path, salvage=True)
    assert_beginning(recording, truth)
    assert recording.time("plant")[-1] == reached


def test_a_chunk_lost_from_an_unfinished_file_is_missed(
    unfinished: Path, altered: Altered, chunk_spans: list[tuple[int, int]]
) -> None:
    start, _ = chunk_spans[1]
    # as an index, which is skipped, the chunk would vanish without a trace
    changed = flipped(unfinished.read_bytes(), start, Opcode.CHUNK ^ Opcode.MESSAGE_INDEX)
    with pytest.raises(RecordingDamageError, match="a chunk before which messages are missing"):
        read(altered(changed))


def test_damage_to_metadata_of_a_finished_file_is_noticed_and_the_series_survive(
    finished: Path, truth: Truth, altered: Altered
) -> None:
    content = finished.read_bytes()
    path = altered(flipped(content, content.index(METADATA["twin"]["seed"].encode(), 8), 1))
    with pytest.raises(RecordingDamageError, match="so metadata may be wrong"):
        read(path)
    recording = read(path, salvage=True)
    assert_beginning(recording, truth)
    assert len(recording["plant.p_B"]) == 1500


# after opcode, length and two times; after CRC and the word zstd too
@pytest.mark.parametrize("offset", [9 + 16, 9 + 16 + 8 + 4 + 8])
@pytest.mark.parametrize("size", [0, 2**40, 2**62, 2**64 - 1])
def test_a_chunk_of_absurd_size_is_refused(
    offset: int, size: int, unfinished: Path, altered: Altered, chunk_spans: list[tuple[int, int]]
) -> None:
    content = bytearray(unfinished.read_bytes())
    position = chunk_spans[0][0] + offset
    content[position : position + 8] = size.to_bytes(8, "little")
    with pytest.raises(
        RecordingDamageError, match=r"would unpack to|whose sizes disagree|a record that does not parse"
    ):
        read(altered(bytes(content)))
