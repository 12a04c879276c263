"""Bags that are none, or no longer: one sentence each."""

from pathlib import Path

import pytest
import zstandard

from tests.recording.logs.bags import TICKS, bag, logged, own, refusal, sqlite_bag
from twin.recording.logs.errors import LogRefused


@pytest.mark.parametrize(
    ("statements", "said"),
    [
        (["DROP TABLE messages"], "no table messages as bags of ROS 2 have; it has"),
        (
            ["DROP TABLE messages", "CREATE VIEW messages AS SELECT 1 id, 2 topic_id, 3 timestamp, 4 data"],
            "no table messages",
        ),
        (["ALTER TABLE messages ADD more BLOB GENERATED ALWAYS AS (zeroblob(900000000))"], "no table messages"),
        (["UPDATE messages SET data = 'text' WHERE id = 3"], "expected bytes"),
        (["UPDATE messages SET timestamp = 'now' WHERE id = 3"], "at time 'now'"),
        (["UPDATE messages SET topic_id = 77 WHERE id = 3"], "a message of topic 77"),
        (["UPDATE topics SET type = x'00'"], "is no text"),
        (["UPDATE topics SET serialization_format = 'protobuf'"], "encoded as protobuf"),
        (["UPDATE messages SET data = x'00010000'"], "its 4 bytes are cut short"),
        (["DELETE FROM messages"], "no messages on /tool"),
        (["DELETE FROM messages WHERE id > 1"], "has 1 message, expected at least 2"),
    ],
)
def test_a_bag_that_is_none_is_refused(tmp_path: Path, statements: list[str], said: str):
    assert said in refusal(sqlite_bag(tmp_path / "b", *statements), "F=/tool.F_N")


@pytest.mark.parametrize("share", [0.0, 0.001, 0.3, 0.9])
def test_a_truncated_sqlite_bag_is_refused(tmp_path: Path, share: float):
    path = sqlite_bag(tmp_path / "b")
    content = path.read_bytes()
    path.write_bytes(content[: int(share * len(content))])
    text = refusal(path, "F=/tool.F_N")
    assert "damaged" in text or "an empty file" in text or "not an SQLite file" in text
    assert "\n" not in text


def test_no_damaged_byte_of_a_bag_gives_anything_but_a_sentence(tmp_path: Path):
    path = sqlite_bag(tmp_path / "b")
    content = path.read_bytes()
    for position in range(16, len(content), 1009):
        path.write_bytes(content[:position] + bytes([content[position] ^ 0x41]) + content[position + 1 :])
        try:
            logged(path, "F=/tool.F_N")
        except LogRefused:
            continue


def test_a_bag_that_does_not_decompress_is_refused(tmp_path: Path):
    folder = bag(tmp_path / "b", {"/tool": [(t, own(t, 1.0)) for t in TICKS]}, "sqlite3", "file")
    path = folder / "b.db3.zstd"
    content = path.read_bytes()
    path.write_bytes(content[:40] + bytes(40) + content[80:])
    assert "does not decompress" in refusal(path, "F=/tool.F_N")
    path.write_bytes(content[: len(content) // 2])
    assert "damaged" in refusal(path, "F=/tool.F_N") or "an empty file" in refusal(path, "F=/tool.F_N")


def test_a_refusal_names_the_packed_file_and_not_where_it_was_unpacked(tmp_path: Path):
    folder = bag(tmp_path / "b", {"/tool": [(t, own(t, 1.0)) for t in TICKS]})
    content = bytearray((folder / "b.mcap").read_bytes())
    content[0] ^= 1
    path = tmp_path / "b.mcap.zstd"
    path.write_bytes(zstandard.compress(bytes(content)))
    assert refusal(path, "F=/tool.F_N").startswith(f"{path}: damaged near byte")
