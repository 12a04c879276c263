"""Recordings whose CRCs are right and whose content is not: nothing is left out without a word, nothing explodes."""

import json
import struct
import zlib
from pathlib import Path

import pytest
import zstandard
from mcap.opcode import Opcode
from mcap.records import Chunk, Metadata, Schema

from tests.kernel.recording import samples
from tests.kernel.recording.forgery import (
    FRONT,
    Record,
    content_of,
    data_records,
    joined,
    message_counts,
    records,
    sealed,
    with_content,
    with_metadata,
)
from tests.memory import growth
from twin.kernel.errors import RecordingDamageError, RecordingError
from twin.kernel.files import MAX_TEXT_BYTES
from twin.kernel.recording.reader import read
from twin.kernel.recording.summary import MIN_UNPACK_ALLOWANCE, decompress_chunk, encode_record, unpack_allowance
from twin.kernel.recording.writer import Writer

CHUNK = Opcode.CHUNK


@pytest.fixture(scope="session")
def data(finished: Path) -> list[Record]:
    """Records of the sample recording, up to the end of its data."""
    return data_records(finished)


def chunks(data: list[Record]) -> list[int]:
    return [place for place, (kind, _) in enumerate(data) if kind == CHUNK]


def without_chunk(data: list[Record], number: int) -> list[Record]:
    """`data` without one of its chunks and the indexes that follow it."""
    places = [*chunks(data), len(data)]
    start, end = places[number], places[number + 1]
    return [record for place, record in enumerate(data) if not start <= place < end or record[0] == Opcode.METADATA]


def test_what_is_sealed_again_unchanged_reads_as_it_did(data: list[Record], tmp_path: Path) -> None:
    recording = read(sealed(data, tmp_path / "x.mcap"))
    samples.assert_beginning(recording, samples.truth())
    assert (recording.complete, len(recording["plant.p_B"])) == (True, samples.TICKS)


def test_a_last_chunk_that_was_taken_out_is_missed_by_the_count(data: list[Record], tmp_path: Path) -> None:
    shorter, counts = without_chunk(data, len(chunks(data)) - 1), message_counts(data)
    path = sealed(shorter, tmp_path / "x.mcap", counts)
    there = sum(message_counts(shorter).values())
    with pytest.raises(RecordingDamageError, match=f"it has {there} messages, its index counts {sum(counts.values())}"):
        read(path)
    recording = read(path, salvage=True)
    samples.assert_beginning(recording, samples.truth())
    assert not recording.complete
    # messages of one topic may not stand for those of another
    one, other, *_ = counts
    moved = counts | {one: counts[one] + 1, other: counts[other] - 1}
    with pytest.raises(RecordingDamageError, match="messages, its index counts"):
        read(sealed(data, path, moved))


@pytest.mark.parametrize("number", [0, 1])
def test_a_chunk_that_was_taken_out_before_others_is_missed_by_them(
    data: list[Record], tmp_path: Path, number: int
) -> None:
    with pytest.raises(
        RecordingDamageError, match=r"declaration of its topics is missing|before which messages are missing"
    ):
        read(sealed(without_chunk(data, number), tmp_path / "x.mcap"))


def test_messages_before_the_declaration_of_their_topic_are_not_believed(data: list[Record], tmp_path: Path) -> None:
    first, *_ = chunks(data)
    inside = records(content_of(data[first][1]))
    moved = [record for record in inside if record[0] == Opcode.MESSAGE]
    moved += [record for record in inside if record[0] != Opcode.MESSAGE]
    changed = with_content(data[first][1], joined(moved))
    with pytest.raises(RecordingDamageError, match="a chunk before which the declaration of its topics is missing"):
        read(sealed([*data[:first], (CHUNK, changed), *data[first + 1 :]], tmp_path / "x.mcap"))


def run_of(path: Path, duration: float, ticks: int, first: int = 0, hole: int = 0) -> Path:
    """A recording that says it is to last `duration` (s), and has `ticks` from `first` on, and a hole in the middle."""
    metadata = {"experiment": {"values": json.dumps({"duration_s": duration})}}
    with Writer(path, [samples.PLANT, samples.ENCODER], samples.TICK, metadata) as writer:
        for topic in (samples.PLANT, samples.ENCODER):
            rows = samples.rows_of(topic)[: -(-ticks // topic.period)]
            half = len(rows) // 2
            writer.write(topic.name, first, rows[:half])
            writer.write(topic.name, first + (half + hole) * topic.period, rows[half:])
    return path


def test_a_run_that_does_not_reach_its_declared_end_says_so(tmp_path: Path) -> None:
    assert read(run_of(tmp_path / "whole.mcap", 0.4, 401)).note == ""
    short = read(run_of(tmp_path / "short.mcap", 0.5, 401))
    assert (short.complete, short.note) == (False, "ends at 0.400 s, though its experiment lasts 0.5 s")
    late = read(run_of(tmp_path / "late.mcap", 0.41, 401, first=10))
    assert late.note == "the first samples of plant are missing"
    # the rows reach the end, and one between is not there
    holed = read(run_of(tmp_path / "hole.mcap", 0.401, 401, hole=1))
    assert holed.note == (
        "samples of plant are missing or moved: after 0.199 s comes 0.201 s, though one is due every 0.001 s"
    )


def test_a_topic_that_ends_before_the_others_says_so(tmp_path: Path) -> None:
    metadata = {"experiment": {"values": '{"duration_s": 0.4}'}}
    with Writer(tmp_path / "x.mcap", [samples.PLANT, samples.ENCODER], samples.TICK, metadata) as writer:
        writer.write("plant", 0, samples.rows_of(samples.PLANT)[:401])
        writer.write("encoder", 0, samples.rows_of(samples.ENCODER)[:200])
    assert read(tmp_path / "x.mcap").note == "samples of encoder are missing: the last is at 0.398 s"


@pytest.mark.parametrize("values", ["", "null", "[1]", '{"duration_s": "x"}', '{"duration_s": -1}', "[" * 9000])
def test_a_duration_that_is_none_is_not_asked(tmp_path: Path, values: str) -> None:
    with Writer(tmp_path / "x.mcap", [samples.PLANT], samples.TICK, {"experiment": {"values": values}}) as writer:
        writer.write("plant", 0, samples.rows_of(samples.PLANT)[:5])
    assert read(tmp_path / "x.mcap").note == ""


def bomb(size: int, declared: int | None = None) -> bytes:
    """A chunk's record of `size` zeros."""
    data = zstandard.ZstdCompressor(level=1).compress(bytes(size))
    crc = zlib.crc32(bytes(size)) if size <= MIN_UNPACK_ALLOWANCE else 0
    return encode_record(Chunk("zstd", data, 0, 0, crc, declared if declared is not None else size))[FRONT.size :]


def test_a_bomb_is_refused_before_it_is_unpacked(data: list[Record], tmp_path: Path) -> None:
    size = 400 * 2**20
    record = bomb(size)
    with growth() as grown:
        for declared in (size, 4 * 2**30, 2**63):
            changed = record[:16] + struct.pack("<Q", declared) + record[24:]
            with pytest.raises(
                RecordingDamageError, match=r"a chunk that would unpack to .* MB, more than 100 times the file"
            ):
                read(sealed([*data, (CHUNK, changed)], tmp_path / "x.mcap", {}))
        # one that says it is small
        with pytest.raises(RecordingDamageError, match="a chunk whose sizes disagree"):
            read(sealed([*data, (CHUNK, record[:16] + struct.pack("<Q", 1000) + record[24:])], tmp_path / "x.mcap", {}))
        assert grown() < size / 4


def test_many_chunks_together_may_not_unpack_to_more_either(data: list[Record], tmp_path: Path) -> None:
    long = encode_record(Schema(99, bytes(MIN_UNPACK_ALLOWANCE // 4), "protobuf", "twin.Long"))
    part = with_content(data[chunks(data)[0]][1], long)
    assert read(sealed([*data, (CHUNK, part)], tmp_path / "x.mcap")).complete
    with pytest.raises(RecordingDamageError, match="more than 100 times the file"):
        read(sealed([*data, *[(CHUNK, part)] * 5], tmp_path / "x.mcap"))


def test_what_a_file_may_unpack_to_grows_with_it() -> None:
    assert unpack_allowance(1000) == MIN_UNPACK_ALLOWANCE
    assert unpack_allowance(10**8) == 10**10


@pytest.mark.parametrize("compression", ["", "lz4", "zstd"])
def test_chunks_of_any_compression_unpack_and_never_to_more_than_they_declare(compression: str) -> None:
    import lz4.frame

    content = bytes(range(256)) * 100
    pack = {"": lambda data: data, "lz4": lz4.frame.compress, "zstd": zstandard.ZstdCompressor().compress}[compression]

    def chunk(size: int) -> Chunk:
        return Chunk(compression, pack(content), 0, 0, 0, size)

    assert decompress_chunk(chunk(len(content)), len(content)) == content
    with pytest.raises(ValueError, match="would unpack to"):
        decompress_chunk(chunk(len(content)), len(content) - 1)
    for size in (0, 1, len(content) - 1, len(content) + 1):
        with pytest.raises(ValueError, match="sizes disagree"):
            decompress_chunk(chunk(size), 2 * len(content))


def test_a_chunk_that_is_none_does_not_unpack() -> None:
    for compression in ("zstd", "lz4"):
        with pytest.raises(ValueError, match="does not decompress"):
            decompress_chunk(Chunk(compression, b"\x00\x01 nothing of the kind", 0, 0, 0, 10), 100)
    with pytest.raises(ValueError, match="compressed by bz2"):
        decompress_chunk(Chunk("bz2", b"", 0, 0, 0, 10), 100)


def test_metadata_is_bounded_in_all(data: list[Record], tmp_path: Path) -> None:
    record = encode_record(Metadata("notes", {"x": "y" * (MAX_TEXT_BYTES // 3)}))[FRONT.size :]
    path = tmp_path / "x.mcap"
    assert read(sealed([*data, *[(Opcode.METADATA, record)] * 2], path)).complete
    with pytest.raises(RecordingDamageError, match="more than 10 MB of metadata"):
        read(sealed([*data, *[(Opcode.METADATA, record)] * 4], path))


def first_chunk(data: list[Record], change: "Change") -> list[Record]:
    """`data` with the records of the first chunk as `change` gives them."""
    place = chunks(data)[0]
    inner = records(content_of(data[place][1]))
    change(inner)
    return [*data[:place], (CHUNK, with_content(data[place][1], joined(inner))), *data[place + 1 :]]


class Change:
    """Replaces `old` by `new`, of the same length, in declarations of `kind`."""

    def __init__(self, kind: int, old: bytes, new: bytes):
        assert len(old) == len(new)
        self.kind, self.old, self.new = kind, old, new

    def __call__(self, inner: list[Record]) -> None:
        for place, (kind, body) in enumerate(inner):
            if kind == self.kind and self.old in body:
                inner[place] = (kind, body.replace(self.old, self.new))
                return
        raise AssertionError("nothing to replace")


@pytest.mark.parametrize(
    "change",
    [
        Change(Opcode.CHANNEL, b"/drive/1", b"/drive/\xff"),
        Change(Opcode.CHANNEL, b"/drive/1", b"/drive/2"),
        Change(Opcode.CHANNEL, b"/drive/1", b"/../../x"),
        Change(Opcode.CHANNEL, b"/drive/1", b"/a\x1b[31mb"),
        Change(Opcode.SCHEMA, b"rad: motor angle", b"rad\xff motor angle"),
        Change(Opcode.SCHEMA, b"rad: motor angle", b"r\x1bd: motor angle"),
        Change(Opcode.SCHEMA, b"18 values", b"2e values"),
        Change(Opcode.SCHEMA, b"18 values", b"9999999 v"),
        Change(Opcode.SCHEMA, b"18 values", b"-2 values"),
    ],
    ids=lambda change: repr(change.new),
)
def test_declarations_that_no_writer_of_ours_makes_are_refused(
    data: list[Record], tmp_path: Path, change: Change
) -> None:
    with pytest.raises(RecordingError, match="not a recording that twin wrote: ") as refused:
        read(sealed(first_chunk(data, change), tmp_path / "x.mcap"))
    assert len(str(refused.value).splitlines()) == 1


def test_a_topic_that_is_declared_again_keeps_what_it_had(data: list[Record], tmp_path: Path) -> None:
    first, *others = chunks(data)
    declared = [
        record for record in records(content_of(data[first][1])) if record[0] in (Opcode.SCHEMA, Opcode.CHANNEL)
    ]
    again = [*data]
    again[others[0]] = (CHUNK, with_content(data[others[0]][1], joined(declared) + content_of(data[others[0]][1])))
    samples.assert_beginning(read(sealed(again, tmp_path / "x.mcap")), samples.truth())
    other = Change(Opcode.CHANNEL, b"/drive/1", b"/drive/9")
    other(declared)
    again[others[0]] = (CHUNK, with_content(data[others[0]][1], joined(declared) + content_of(data[others[0]][1])))
    with pytest.raises(RecordingError, match="two topics share the channel"):
        read(sealed(again, tmp_path / "x.mcap"))


def test_metadata_can_be_replaced_by_what_forges_it(data: list[Record], tmp_path: Path) -> None:
    changed = with_metadata(data, lambda name, entries: {"x": "y"} if name == "twin" else None)
    assert read(sealed(changed, tmp_path / "x.mcap")).metadata == {"twin": {"x": "y"}}
