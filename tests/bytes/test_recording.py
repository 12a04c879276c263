from pathlib import Path
from typing import Any

import pytest
from mcap.writer import CompressionType, Writer

from tests.bytes.recording import digests

ROWS = [(tick * 1_000_000, tick % 251) for tick in range(3000)]
"""Log times (ns) and a number of each message: three seconds."""


def recorded(
    path: Path, rows: list[tuple[int, int]] = ROWS, other: int = 0, other_first: bool = False
) -> dict[str, Any]:
    """Digests of a recording with `rows` in /a, and one message that says `other` twice in /b."""
    with path.open("wb") as file:
        writer = Writer(file, compression=CompressionType.ZSTD, chunk_size=4096)
        writer.start()
        schema = writer.register_schema("T", "protobuf", b"layout")
        topics = ("/b", "/a") if other_first else ("/a", "/b")
        channel = {topic: writer.register_channel(topic, "protobuf", schema, {"unit": "N"}) for topic in topics}
        for number, (time, value) in enumerate(rows):
            writer.add_message(channel["/a"], time, bytes([value]) * 9, time, number)
        for length in (5, 7):
            writer.add_message(channel["/b"], 10, bytes([other]) * length, 10)
        writer.add_metadata("about", {"key": "value"})
        writer.finish()
    return digests(path)


def test_the_same_messages_have_the_same_digests_in_whatever_order_topics_come(tmp_path: Path) -> None:
    first = recorded(tmp_path / "1.mcap")
    assert first["/a"]["messages"] == 3000 and first["/b"]["messages"] == 2
    assert "value" in first["metadata about"] and '"N"' in first["/a layout"]
    assert recorded(tmp_path / "2.mcap", other_first=True) == first


@pytest.mark.parametrize("second", [0, 1, 2])
def test_one_other_byte_changes_the_digest_of_its_topic_and_second_alone(tmp_path: Path, second: int) -> None:
    rows = list(ROWS)
    time, value = rows[second * 1000 + 7]
    rows[second * 1000 + 7] = time, value + 1
    before, after = recorded(tmp_path / "1.mcap"), recorded(tmp_path / "2.mcap", rows)
    assert before["/b"] == after["/b"] and before["/a"]["digest"] != after["/a"]["digest"]
    seconds = [[one["/a"]["seconds"][at : at + 8] for at in (0, 8, 16)] for one in (before, after)]
    assert [a == b for a, b in zip(*seconds, strict=True)] == [place != second for place in range(3)]


def test_another_time_a_missing_message_and_messages_of_other_lengths_are_noticed(tmp_path: Path) -> None:
    before = recorded(tmp_path / "1.mcap")
    later = [*ROWS[:-1], (ROWS[-1][0] + 1, ROWS[-1][1])]
    assert recorded(tmp_path / "2.mcap", later)["/a"] != before["/a"]
    assert recorded(tmp_path / "3.mcap", ROWS[:-1])["/a"]["messages"] == 2999
    assert recorded(tmp_path / "4.mcap", other=1)["/b"] != before["/b"]


def test_what_is_no_recording_is_refused(tmp_path: Path) -> None:
    (tmp_path / "no.mcap").write_bytes(b"no")
    with pytest.raises(ValueError, match="no MCAP file"):
        digests(tmp_path / "no.mcap")
