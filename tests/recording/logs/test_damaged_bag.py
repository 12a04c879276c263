"""Bags that are none, or no longer: one sentence each."""

import re
import sqlite3
import tracemalloc
from contextlib import closing
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
            "has 'CREATE VIEW messages AS SELECT 1 id, 2 t'; bags of ROS 2 have stored tables only",
        ),
        (
            ["ALTER TABLE messages ADD more BLOB GENERATED ALWAYS AS (zeroblob(900000000))"],
            "column more of table messag",
        ),
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


COMPUTED = "substr(hex(zeroblob(100000000)), 1, 20)"
DEFINITIONS = "DROP TABLE message_definitions"
VIEW = f"CREATE VIEW {{name}} AS SELECT 'a' topic_type, 'x' encoding, {COMPUTED} encoded_message_definition"
LYING = "INSERT INTO sqlite_master VALUES('table', 'message_definitions', 'message_definitions', 0, '{text}')"


@pytest.mark.parametrize(
    ("statements", "said"),
    [
        # one row of 200 MB, and what tells of it hidden from a look at the text
        (
            [
                DEFINITIONS,
                "CREATE TABLE message_definitions(topic_type TEXT, encoding TEXT, "
                f"encoded_message_definition TEXT GENERATED ALWAYS AS/**/({COMPUTED}))",
                "INSERT INTO message_definitions VALUES('robot_msgs/msg/Tool', 'x')",
            ],
            "column encoded_message_definition of table message_definitions is computed",
        ),
        ([f"ALTER TABLE topics ADD more TEXT AS/**/({COMPUTED})"], "column more of table topics is computed"),
        ([DEFINITIONS, VIEW.format(name="message_definitions")], "has 'CREATE VIEW message_definitions"),
        # one that says that it is a table; SQLite itself refuses some of them
        (
            [
                DEFINITIONS,
                "PRAGMA writable_schema = ON",
                LYING.format(text="CREATE VIEW message_definitions AS SELECT 1"),
            ],
            "message_definitions",
        ),
        (
            [DEFINITIONS, "CREATE VIRTUAL TABLE message_definitions USING fts5(topic_type, encoding)"],
            "has 'CREATE VIRTUAL TABLE message_definitions",
        ),
        # a text of 100 kB in each of a thousand rows that store nothing
        (
            [
                "DROP TABLE topics",
                "CREATE TABLE topics(id INTEGER PRIMARY KEY, name TEXT, type TEXT)",
                "INSERT INTO topics SELECT value, 'a', 'b' FROM generated",
                f"ALTER TABLE topics ADD serialization_format TEXT DEFAULT '{100_000 * 'x'}'",
            ],
            "rows of more bytes than it has",
        ),
        (
            [
                DEFINITIONS,
                "CREATE TABLE message_definitions(topic_type TEXT, encoding TEXT)",
                "INSERT INTO message_definitions SELECT value, 'b' FROM generated",
                f"ALTER TABLE message_definitions ADD encoded_message_definition TEXT DEFAULT '{100_000 * 'x'}'",
            ],
            "rows of more bytes than it has",
        ),
    ],
)
def test_what_a_bag_computes_instead_of_storing_it_is_refused_before_it_is_computed(
    tmp_path: Path, statements: list[str], said: str
):
    thousand = (
        "(WITH RECURSIVE n(value) AS (SELECT 1 UNION ALL SELECT value + 1 FROM n WHERE value < 1000) SELECT * FROM n)"
    )
    path = sqlite_bag(tmp_path / "b", *(each.replace("generated", thousand) for each in statements))
    tracemalloc.start()
    try:
        assert said in refusal(path, "F=/tool.F_N")
        assert tracemalloc.get_traced_memory()[1] < 20e6
    finally:
        tracemalloc.stop()


@pytest.mark.parametrize("key", ["", " PRIMARY KEY"])
def test_pages_that_hold_each_other_are_not_read_for_ever(tmp_path: Path, key: str):
    """A page of pointers, each to the same page of pointers, and so on: of 30 pages 10^9 rows."""
    path = sqlite_bag(
        tmp_path / "b",
        "DROP TABLE messages",
        f"CREATE TABLE messages(id INTEGER{key}, topic_id INTEGER, timestamp INTEGER, data BLOB)",
        "WITH RECURSIVE n(k) AS (SELECT 1 UNION ALL SELECT k + 1 FROM n WHERE k < 2000) "
        "INSERT INTO messages SELECT k, 1, k, zeroblob(200) FROM n",
    )
    with closing(sqlite3.connect(path)) as bag:
        (root,) = bag.execute("SELECT rootpage FROM sqlite_master WHERE name = 'messages'").fetchone()
        (size,) = bag.execute("PRAGMA page_size").fetchone()
    content = bytearray(path.read_bytes())
    pages = [root, *_children(content, root, size)[:4]]
    leaf = _children(content, root, size)[5]
    pointers = bytes(content[(root - 1) * size : root * size])
    for page, below in zip(pages, [*pages[1:], leaf], strict=True):
        content[(page - 1) * size : page * size] = pointers
        _point(content, page, size, below)
    path.write_bytes(content)
    assert re.search("damaged: (more rows|rows of more bytes) than it has", refusal(path, "F=/tool.F_N"))


def _places(content: bytearray, page: int, size: int) -> list[int]:
    """Where the pointers of an interior page stand (https://sqlite.org/fileformat2.html)."""
    start = (page - 1) * size
    assert content[start] == 5
    cells = int.from_bytes(content[start + 3 : start + 5], "big")
    offsets = [int.from_bytes(content[start + 12 + 2 * k : start + 14 + 2 * k], "big") for k in range(cells)]
    return [*(start + offset for offset in offsets), start + 8]


def _children(content: bytearray, page: int, size: int) -> list[int]:
    return [int.from_bytes(content[place : place + 4], "big") for place in _places(content, page, size)]


def _point(content: bytearray, page: int, size: int, below: int) -> None:
    for place in _places(content, page, size):
        content[place : place + 4] = below.to_bytes(4, "big")


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
