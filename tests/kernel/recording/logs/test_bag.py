import re
import shutil
import sqlite3
import sys
import tracemalloc
from contextlib import closing
from pathlib import Path

import numpy as np
import pytest
import zstandard
from mcap.writer import Writer

from tests.kernel.recording.logs import bags
from tests.kernel.recording.logs.bags import (
    START,
    TICKS,
    N,
    bag,
    joints,
    logged,
    numbers,
    own,
    pose,
    refusal,
    sqlite_bag,
    twist,
    wrench,
)
from twin.kernel.recording.logs.log import LogError
from twin.kernel.recording.logs.reader import is_recording

LATER = 0.001
"""s from stamp to log time."""


@pytest.fixture(scope="module")
def lab(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A bag of everything in MCAP."""
    return bag(
        tmp_path_factory.mktemp("lab") / "lab",
        {
            "/joint_states": [(t + LATER, joints(t, hip=0.1 * k, knee=-0.2 * k)) for k, t in enumerate(TICKS)],
            "/ft": [(t + LATER, wrench(t, float(k))) for k, t in enumerate(TICKS)],
            "/tool": [(t + LATER, own(t, 2.0 * k)) for k, t in enumerate(TICKS)],
            "/pose": [(t + LATER, pose(t, -0.1 - 0.001 * k)) for k, t in enumerate(TICKS)],
            "/twist": [(t + LATER, twist(t, 0.1 * k)) for k, t in enumerate(TICKS)],
            "/numbers": [(t + LATER, numbers(k, 3.0 * k)) for k, t in enumerate(TICKS)],
        },
    )


def test_messages_of_ros_2_are_series_in_the_units_of_rep_103(lab: Path):
    fields = ["joint_states.position.knee", "joint_states.effort[0]", "ft.wrench.force.z", "pose.pose.position.z"]
    log = logged(lab, *(f"{one}=/{one}" for one in [*fields, "twist.twist.linear.z", "numbers.data[1]", "tool.F_N"]))
    k = np.arange(N)
    expected = {"knee": -0.2 * k, "[0]": -k, "force.z": k, "position.z": -0.1 - 0.001 * k, "linear.z": 0.1 * k}
    expected |= {"[1]": 3.0 * k, "F_N": 2.0 * k}
    for series, (end, values) in zip(log.series.items(), expected.items(), strict=True):
        assert series[0].endswith(end)
        np.testing.assert_allclose(series[1].values, values, rtol=1e-15)
        # a double holds a time of day to 0.24 us
        np.testing.assert_allclose(series[1].t, 0.01 * k, atol=5e-7)
    assert [one.unit for one in log.series.values()] == ["rad", "N m", "N", "m", "m/s", "1", "N"]


def test_another_unit_and_sign_than_those_of_rep_103_are_for_the_map_to_say(lab: Path):
    log = logged(lab, "x=-/joint_states.position.knee[deg]")
    np.testing.assert_allclose(log["x"].values, np.deg2rad(0.2 * np.arange(N)), rtol=1e-15)


@pytest.mark.parametrize(
    ("storage", "compressed"),
    [("sqlite3", ""), ("sqlite3", "file"), ("sqlite3", "message"), ("mcap", "file"), ("mcap", "message")],
)
def test_every_storage_of_rosbag2_gives_the_same_series(tmp_path: Path, storage: str, compressed: str):
    folder = bag(tmp_path / "lab", {"/tool": [(t, own(t, k)) for k, t in enumerate(TICKS)]}, storage, compressed)
    file = next(file for file in folder.iterdir() if file.suffix != ".yaml")
    for path in (folder, file):
        log = logged(path, "F=/tool.F_N", "q=/tool.q[2]", "from=/tool.from", "time=when")
        assert log["F"].values.tolist() == list(range(N))
        assert log["q"].values.tolist() == [4.0] * N
        assert log["from"].values.tolist() == [3.0] * N


def test_files_of_one_bag_are_one_log_and_one_that_is_not_there_is_told(tmp_path: Path):
    parts = [
        bag(tmp_path / f"p{part}", {"/tool": [(t, own(t, part)) for t in ticks]}, "sqlite3")
        for part, ticks in enumerate((TICKS[:10], TICKS[10:]))
    ]
    folder = tmp_path / "bag"
    folder.mkdir()
    # by name the tenth comes before the second
    for number, part in zip((2, 10), parts, strict=True):
        shutil.copy(part / f"{part.name}.db3", folder / f"bag_{number}.db3")
    log = logged(folder, "F=/tool.F_N")
    assert log["F"].values.tolist() == [0.0] * 10 + [1.0] * 10
    assert "no metadata.yaml" in log.notes[0]
    (folder / "metadata.yaml").write_text(
        "rosbag2_bagfile_information:\n  relative_file_paths:\n    - bag_2.db3\n    - bag_3.db3\n    - bag_10.db3\n"
    )
    assert logged(folder, "F=/tool.F_N").notes[0] == "bag_3.db3 is missing, which metadata.yaml lists"


def test_a_joint_is_found_by_its_name_whatever_its_place_in_the_message(tmp_path: Path):
    said = [joints(t, hip=1.0, knee=2.0) if k % 2 else joints(t, knee=2.0, hip=1.0) for k, t in enumerate(TICKS)]
    # another node publishes the wrist on the same topic
    said[5] = joints(TICKS[5], wrist=3.0)
    log = logged(bag(tmp_path / "b", {"/j": list(zip(TICKS, said, strict=True))}), "hip=/j.position.hip")
    assert log["hip"].values.tolist() == [1.0] * (N - 1)
    assert "1 sample missing in a gap of 0.02 s" in log.notes[-1]
    assert "there are" in refusal(tmp_path / "b", "x=/j.position.elbow")
    assert "did you mean 'knee'" in refusal(tmp_path / "b", "x=/j.position.kneee")
    assert "no element [5]" in refusal(tmp_path / "b", "x=/j.position[5]")


def test_times_are_log_times_or_stamps_and_topics_without_stamps_keep_log_times(lab: Path):
    log = logged(lab, "time=header.stamp", "F=/ft.wrench.force.z", "n=/numbers.data[0]")
    assert log["n"].t[0] - log["F"].t[0] == pytest.approx(LATER, abs=5e-7)
    assert log.notes[0] == "/numbers has no header.stamp: its log times are used"
    assert "has no field 'header.stamp'" in refusal(lab, "time=header.stamp", "n=/numbers.data[0]")


def test_log_times_do_not_stand_in_for_stamps_of_another_clock(tmp_path: Path):
    folder = bag(
        tmp_path / "b",
        {
            "/ft": [(t, wrench(t - START, 1.0)) for t in TICKS],
            "/n": [(t, numbers(1.0)) for t in TICKS],
        },
    )
    text = refusal(folder, "time=header.stamp", "F=/ft.wrench.force.z", "n=/n.data[0]")
    assert "/n has no field 'header.stamp'; it has layout, data; its log times cannot be used, they differ by " in text


def test_a_log_tells_of_its_two_clocks(tmp_path: Path):
    """The robot's clock is 3 s slow and loses 50 ms in the 0.2 s."""
    drift = [(t, wrench(t - 3.0 - 0.25 * (t - START), 1.0)) for t in TICKS]
    folder = bag(tmp_path / "b", {"/ft": drift})
    by_log, by_stamp = (logged(folder, "F=/ft.wrench.force.z", *time) for time in ([], ["time=header.stamp"]))
    for log, used in ((by_log, "log times"), (by_stamp, "stamps")):
        assert log.notes[0].startswith("two clocks: the stamps of /ft are 3.00")
        assert "behind its log times, and by 0.04" in log.notes[0]
        assert log.notes[0].endswith(f"s more at the end; {used} are used")


def test_a_log_tells_of_a_restart(tmp_path: Path):
    stamps = [100.0 + 0.01 * k for k in range(10)] + [0.01 * k for k in range(10)]
    folder = bag(tmp_path / "b", {"/ft": [(t, wrench(s, 1.0)) for t, s in zip(TICKS, stamps, strict=True)]})
    assert "the stamps of /ft restart 0.100 s after its first message: from 100.090 s back to 0.000 s" in (
        logged(folder, "F=/ft.wrench.force.z").notes
    )
    assert "its stamps restart at message 11 of 20: from 100.090000 s back to 0.000000 s; cut the log" in refusal(
        folder, "F=/ft.wrench.force.z", "time=header.stamp"
    )


def test_stamps_that_nobody_sets_are_told(tmp_path: Path):
    folder = bag(tmp_path / "b", {"/ft": [(t, wrench(0.0, 1.0)) for t in TICKS]})
    assert len(logged(folder, "F=/ft.wrench.force.z")["F"].t) == N
    assert "header.stamp is 0 in all messages" in refusal(folder, "F=/ft.wrench.force.z", "time=header.stamp")


def test_a_message_whose_stamp_is_not_a_number_is_left_out(tmp_path: Path):
    said = [(t, own(t, 1.0, stamp=np.nan if k == 3 else t)) for k, t in enumerate(TICKS)]
    log = logged(bag(tmp_path / "b", {"/tool": said}), "F=/tool.F_N", "time=stamp")
    assert len(log["F"].t) == N - 1 and "1 sample missing" in log.notes[-1]


def test_a_bag_without_a_map_names_topics_and_types(lab: Path):
    text = refusal(lab)
    assert "/ft (geometry_msgs/msg/WrenchStamped)" in text
    assert "choose with --map" in text


def test_a_bag_is_no_recording_of_twin(lab: Path):
    assert not is_recording(lab)


def test_idl_definitions_are_read(tmp_path: Path):
    definition = b"""
        module robot_msgs { module msg {
          module Tool_Constants { const unsigned long SIZE = 3; };
          @verbatim (language="comment", text="forces (of the tool) * << ((")
          struct Tool { double F; double q[3]; sequence<float> more; };
        }; };"""
    text = idl(tmp_path / "a.mcap", definition)
    log = logged(text, "F=/tool.F[mN]", "q=/tool.q[2]", "m=/tool.more[0]")
    assert [log[name].values.tolist() for name in "Fqm"] == [[0.001, 0.001], [4.0, 4.0], [0.5, 0.5]]


def idl(path: Path, definition: bytes, encoding: str = "ros2idl", data: bytes | None = None) -> Path:
    """A log of two messages of robot_msgs/msg/Tool."""
    body = np.array([1.0, 2.0, 3.0, 4.0]).tobytes() + np.uint32(1).tobytes() + np.float32(0.5).tobytes()
    with path.open("wb") as file:
        writer = Writer(file)
        writer.start(profile="ros2")
        schema = writer.register_schema(bags.OWN, encoding, definition)
        channel = writer.register_channel("/tool", "cdr", schema)
        for k in range(2):
            writer.add_message(channel, k, b"\0\1\0\0" + body if data is None else data, k)
        writer.finish()
    return path


@pytest.mark.parametrize(
    ("definition", "encoding", "said"),
    [
        (b"string[1000000000] x", "ros2msg", "more than 4096 strings or messages"),
        (b"Tool[] inner", "ros2msg", "holds itself"),
        (b"Other inner", "ros2msg", "lacks robot_msgs/msg/Other"),
        (b"float64 x\nfloat64 x", "ros2msg", "cannot be used"),
        (b"nonsense", "ros2msg", "is no ros2msg"),
        (b"\xff\xfe", "ros2msg", "is no ros2msg"),
        (b"float64 x", "omgidl", "written in 'omgidl'; ros2msg and ros2idl are read"),
        (b"float64 x\n" * 30_000, "ros2msg", "has 300000 letters"),
        (b"module a {" * 300, "ros2idl", "is no ros2idl"),
        (b"const long c = 1 << 9999999999;", "ros2idl", "works out a constant"),
        (b"const long c = 1+(1+(1+(1)));", "ros2idl", "works out a constant"),
        (b"struct Other { double x; };", "ros2idl", "is lacking"),
    ],
)
def test_a_definition_that_is_wrong_or_asks_for_too_much_is_refused(
    tmp_path: Path, definition: bytes, encoding: str, said: str
):
    assert said in refusal(idl(tmp_path / "a.mcap", definition, encoding), "F=/tool.F")


@pytest.mark.parametrize(
    ("data", "said"),
    [
        (b"", "it has 0 bytes"),
        (b"\0\3\0\0" + bytes(16), "begins with 00 03; plain CDR"),
        (b"\0\1\0\0\xff\xff\xff\xff" + bytes(8), "cut short, or lengths in them are wrong"),
        (b"\0\1\0\0\2\0\0\0" + bytes(8), "cut short, or lengths in them are wrong"),
        (b"\0\1\0\0\1\0\0\0" + bytes(400), "cut short, or lengths in them are wrong"),
        (b"\x28\xb5\x2f\xfd" + bytes(8), "it does not decompress"),
    ],
)
def test_messages_that_are_cut_short_or_endless_are_refused(tmp_path: Path, data: bytes, said: str):
    text = refusal(idl(tmp_path / "a.mcap", b"float64[] x", "ros2msg", data), "F=/tool.x[0]")
    assert "message 1 of 2: not a robot_msgs/msg/Tool as its definition has it" in text
    assert said in text


def test_a_type_that_the_bag_does_not_define_is_read_by_its_file_in_the_folder(tmp_path: Path):
    path = sqlite_bag(tmp_path / "b", "DROP TABLE message_definitions")
    assert "is lacking, and ROS 2 itself has no such type; put its file into the bag's folder" in refusal(
        path, "F=/tool.F_N"
    )
    file = path.parent / "robot_msgs/msg/Tool.msg"
    file.parent.mkdir(parents=True)
    file.write_text(bags.OWN_TEXT)
    assert logged(path.parent, "F=/tool.F_N")["F"].values.tolist() == [2.0] * N
    assert logged(path, "F=/tool.F_N")["F"].values.tolist() == [2.0] * N


def test_types_of_ros_2_itself_need_no_definition(tmp_path: Path):
    folder = bag(tmp_path / "b", {"/ft": [(t, wrench(t, 2.0)) for t in TICKS]}, "sqlite3")
    with closing(sqlite3.connect(folder / "b.db3")) as rows:
        rows.execute("DROP TABLE message_definitions")
        rows.commit()
    assert logged(folder, "F=/ft.wrench.force.z")["F"].values.tolist() == [2.0] * N


def test_a_folder_without_files_of_a_bag_is_refused(tmp_path: Path):
    (tmp_path / "metadata.yaml").write_text("rosbag2_bagfile_information:\n  relative_file_paths:\n    - b_0.db3\n")
    assert refusal(tmp_path, "F=/tool.F_N").endswith(
        "a bag without a file; b_0.db3 is missing, which metadata.yaml lists"
    )


def test_a_folder_with_bags_in_it_is_refused_with_their_names(lab: Path):
    folder = lab.parent
    assert refusal(folder, "F=/tool.F_N") == f"{folder}: no recording, but the bag {lab}; name it"
    with pytest.raises(LogError, match="name it"):
        is_recording(folder)


def test_without_rosbags_the_extra_is_named(lab: Path, monkeypatch: pytest.MonkeyPatch):
    for name in ("rosbags.serde", "rosbags.typesys"):
        monkeypatch.setitem(sys.modules, name, None)
    text = refusal(lab, "F=/ft.wrench.force.z")
    assert text.endswith("which needs rosbags; install it with: pip install 'rosbags>=0.11'")
    assert "\n" not in text


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
        (["UPDATE topics SET type = x'00'"], "neither text nor a number"),
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


@pytest.mark.slow
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
        except LogError:
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
