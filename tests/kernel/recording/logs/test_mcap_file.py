import json
import os
import re
import sys
import zlib
from collections.abc import Sequence
from pathlib import Path

import lz4.frame
import numpy as np
import pytest
import zstandard
from google.protobuf.descriptor_pb2 import FileDescriptorSet
from google.protobuf.descriptor_pool import DescriptorPool
from google.protobuf.message_factory import GetMessageClass
from google.protobuf.timestamp_pb2 import Timestamp
from mcap.opcode import Opcode
from mcap.records import Channel, Chunk, DataEnd, Footer, Header, Message, Schema
from mcap.writer import CompressionType, Writer

from tests.memory import growth
from twin.kernel.recording.logs.column_map import column_map
from twin.kernel.recording.logs.log import LogError
from twin.kernel.recording.logs.reader import read_log
from twin.kernel.recording.logs.topics import MCAP_MAGIC, read_topics
from twin.kernel.recording.summary import MAX_CHUNK_BYTES, MIN_UNPACK_ALLOWANCE, decompress_chunk, encode_record

F = [4.0, 5.0, 6.5]
# a schema whose first file imports its second: readers must not rely on the order
STAMPED = "robot.Stamped"


def stamped_schema() -> bytes:
    files = FileDescriptorSet()
    file = files.file.add(name="robot.proto", package="robot", syntax="proto3")
    file.dependency.append(Timestamp.DESCRIPTOR.file.name)
    message = file.message_type.add(name="Stamped")
    message.field.add(name="stamp", number=1, type=11, label=1, type_name=".google.protobuf.Timestamp")
    message.field.add(name="F_N", number=2, type=1, label=1)
    message.field.add(name="theta", number=3, type=1, label=3)
    Timestamp.DESCRIPTOR.file.CopyToProto(files.file.add())
    return files.SerializeToString()


def stamped(seconds: float, F_N: float, theta: Sequence[float]) -> bytes:
    pool = DescriptorPool()
    for file in reversed(FileDescriptorSet.FromString(stamped_schema()).file):
        pool.Add(file)
    message = GetMessageClass(pool.FindMessageTypeByName(STAMPED))(F_N=F_N, theta=theta)
    message.stamp.FromNanoseconds(round(seconds * 1e9))
    return message.SerializeToString()


def json_log(path: Path, messages: Sequence[dict], times: Sequence[float] = (), encoding: str = "json") -> Path:
    """A log of /wrench at `times` (s), every 10 ms without them."""
    with path.open("wb") as file:
        writer = Writer(file, compression=CompressionType.NONE, chunk_size=200)
        writer.start(library="robot's own")
        schema = writer.register_schema("Wrench", "jsonschema", b"{}")
        channel = writer.register_channel("/wrench", encoding, schema)
        for k, message in enumerate(messages):
            time = round(1e9 * (times[k] if times else 0.01 * k))
            writer.add_message(channel, time, json.dumps(message).encode(), time)
        writer.finish()
    return path


def wrenches(forces: Sequence[float]) -> list[dict]:
    return [{"force": {"z": force}, "q": [1, 90.0], "frame": "tool"} for force in forces]


def refusal(path: Path, *maps: str) -> str:
    with pytest.raises(LogError) as refused:
        read_log(path, column_map(maps))
    return str(refused.value)


def test_a_field_of_a_json_message_is_a_series_in_si_with_sign_and_unit_of_the_map(tmp_path: Path):
    path = json_log(tmp_path / "a.mcap", wrenches(F))
    log = read_log(path, column_map(["F=-/wrench.force.z[mN]", "theta=/wrench.q[1][deg]"]))
    np.testing.assert_allclose(log["F"].values, [-0.004, -0.005, -0.0065], rtol=1e-15)  # one rounding
    np.testing.assert_allclose(log["theta"].values, np.pi / 2, rtol=1e-15)
    np.testing.assert_allclose(log["F"].t, [0.0, 0.01, 0.02], rtol=1e-15)
    assert (log["F"].unit, log["theta"].unit, log.notes) == ("N", "rad", ())


def test_protobuf_messages_are_read_by_the_schema_in_the_file_and_timed_by_their_own_stamp(tmp_path: Path):
    path = tmp_path / "p.mcap"
    with path.open("wb") as file:
        writer = Writer(file)
        writer.start()
        schema = writer.register_schema(STAMPED, "protobuf", stamped_schema())
        channel = writer.register_channel("/robot/tool", "protobuf", schema)
        for k, F_N in enumerate(F):
            writer.add_message(channel, 7, stamped(1.7e9 + k, F_N, [0.1, 0.2]), 7)
        writer.finish()
    log = read_log(path, column_map(["time=stamp", "F=/robot/tool.F_N", "theta[1]=/robot/tool.theta[1][rad]"]))
    assert log["F"].values.tolist() == F
    assert log["F"].t.tolist() == [0.0, 1.0, 2.0]
    assert log["F"].unit == "N"
    assert log["theta[1]"].values.tolist() == [0.2, 0.2, 0.2]
    assert log.notes[0].startswith("two clocks: the stamps of /robot/tool are 1700000000.000 s ahead of its log times")
    assert "2023-11-14 22:13:20 UTC" in log.notes[1]
    assert "two messages at 0 s" in refusal(path, "F=/robot/tool.F_N")


def schema_of(*names: str, imports: str = "") -> bytes:
    """A schema of one file, `a.proto`, with the messages `names`."""
    files = FileDescriptorSet()
    file = files.file.add(name="a.proto", package="a", dependency=[imports] if imports else [])
    for name in names:
        file.message_type.add(name=name)
    return files.SerializeToString()


@pytest.mark.parametrize(
    ("schema", "said"),
    [
        (b"\xff", "its schema a.Tool cannot be used: "),
        (schema_of("Other"), "its schema a.Tool cannot be used: "),
        (schema_of("Tool", imports="a.proto"), "its schema a.Tool cannot be used: "),
        (schema_of("Tool", "Tool"), "its schema a.Tool cannot be used: "),
        (schema_of(2**20 * "a"), "its schema a.Tool has 1048600 bytes, more than 1048576"),
    ],
    ids=["none", "without it", "imports itself", "twice", "too large"],
)
def test_a_protobuf_schema_that_is_wrong_or_asks_for_too_much_is_refused(tmp_path: Path, schema: bytes, said: str):
    path = tmp_path / "p.mcap"
    with path.open("wb") as file:
        writer = Writer(file)
        writer.start()
        channel = writer.register_channel("/t", "protobuf", writer.register_schema("a.Tool", "protobuf", schema))
        for k in range(2):
            writer.add_message(channel, k, b"", k)
        writer.finish()
    text = refusal(path, "F=/t.F_N")
    assert re.search(f"/t: {said}", text) and "\n" not in text


def test_messages_out_of_order_are_put_in_order(tmp_path: Path):
    log = read_log(json_log(tmp_path / "a.mcap", wrenches(F), [0.2, 0.0, 0.1]), column_map(["F=/wrench.force.z[N]"]))
    assert log["F"].values.tolist() == [5.0, 6.5, 4.0]


def test_a_truncated_log_is_read_up_to_there_and_says_so(tmp_path: Path):
    path = json_log(tmp_path / "a.mcap", wrenches([*F] * 20))
    path.write_bytes(path.read_bytes()[:3000])
    log = read_log(path, column_map(["F=/wrench.force.z[N]"]))
    assert 10 < len(log["F"].t) < 60
    assert log.notes[0].startswith("the file ends early: read 0.")


def test_a_damaged_log_is_refused_by_its_crc(tmp_path: Path):
    path = json_log(tmp_path / "a.mcap", wrenches(F))
    content = bytearray(path.read_bytes())
    content[content.index(b'"z": 5.0') + 5] = ord("7")
    path.write_bytes(content)
    assert "damaged near byte" in refusal(path, "F=/wrench.force.z[N]")


def test_whatever_byte_is_damaged_is_refused_or_harmless(tmp_path: Path):
    """No byte of a log that fails a CRC gives another value, and none gives anything but a sentence."""
    content = json_log(tmp_path / "a.mcap", wrenches(F)).read_bytes()
    path = tmp_path / "b.mcap"
    for position in range(8, len(content), 7):
        path.write_bytes(content[:position] + bytes([content[position] ^ 0x41]) + content[position + 1 :])
        try:
            log = read_log(path, column_map(["F=/wrench.force.z[N]"]))
        except LogError:
            continue
        assert log["F"].values.tolist() == F


def test_without_a_map_the_topics_are_named(tmp_path: Path):
    text = refusal(json_log(tmp_path / "a.mcap", wrenches(F)))
    assert text.endswith("another tool's recording, with /wrench (Wrench); choose with --map NAME=/TOPIC.FIELD[UNIT]")


@pytest.mark.parametrize(
    ("entry", "expected"),
    [
        ("F=/wrensh.force.z[N]", "no topic of '/wrensh.force.z' for F; did you mean '/wrench'?"),
        ("F=/wrench.force.y[N]", "/wrench has no field 'force.y'; it has z"),
        ("F=/wrench.q[2][N]", "no field 'q[2]'; no element [2]"),
        ("F=/wrench.frame", "expected a number, got 'tool'"),
        ("F=/wrench.force", "expected a number, got a message of z"),
        ("F=/wrench.force.z[NN]", "unknown unit 'NN'"),
    ],
)
def test_a_map_that_does_not_fit_is_refused_with_what_is_there(tmp_path: Path, entry: str, expected: str):
    assert expected in refusal(json_log(tmp_path / "a.mcap", wrenches(F)), entry)


def test_an_encoding_that_is_not_read_is_named(tmp_path: Path):
    path = json_log(tmp_path / "a.mcap", wrenches(F), encoding="cbor")
    assert "encoded as cbor; protobuf, json and cdr are read" in refusal(path, "F=/wrench.force.z[N]")


def test_values_that_are_no_numbers_are_left_out_and_refused_if_there_are_no_others(tmp_path: Path):
    path = json_log(tmp_path / "a.mcap", wrenches([4.0, float("nan")]))
    assert "force.z is in 1 message, expected at least 2" in refusal(path, "F=/wrench.force.z[N]")
    path = json_log(tmp_path / "b.mcap", wrenches([float("nan")] * 3))
    assert "force.z is nan in all messages" in refusal(path, "F=/wrench.force.z[N]")
    log = read_log(path, column_map(["F=/wrench.force.z[N]", "q=/wrench.q[0]"]))
    assert list(log.series) == ["q"] and "left out: /wrench.force.z is nan in all messages" in log.notes[0]
    with pytest.raises(LogError, match="is nan in all messages"):
        log["F"]


def test_a_log_without_messages_is_refused(tmp_path: Path):
    assert "no messages on /wrench (Wrench)" in refusal(json_log(tmp_path / "a.mcap", []), "F=/wrench.force.z[N]")
    (tmp_path / "b.mcap").write_bytes(b"")
    assert "an empty file; expected a recording" in refusal(tmp_path / "b.mcap")
    (tmp_path / "c.mcap").write_text("t_s,F_N\n0,1\n1,2\n")
    assert "not an MCAP file" in refusal(tmp_path / "c.mcap")


def test_one_message_is_no_series(tmp_path: Path):
    assert "has 1 message, expected" in refusal(json_log(tmp_path / "a.mcap", wrenches([1.0])), "F=/wrench.force.z[N]")


def one_chunk(path: Path, size: int, compression: str = "zstd") -> Path:
    """Another tool's file with a chunk of zeros that declares `size` bytes."""
    pack = {"zstd": zstandard.ZstdCompressor().compress, "lz4": lz4.frame.compress}[compression]
    chunk = Chunk(compression, pack(bytes(MIN_UNPACK_ALLOWANCE + 1)), 0, 0, 0, size)
    path.write_bytes(MCAP_MAGIC + encode_record(Header("", "robot's own")) + encode_record(chunk))
    return path


@pytest.mark.parametrize("compression", ["zstd", "lz4"])
def test_a_bomb_is_refused_before_it_is_unpacked(tmp_path: Path, compression: str):
    for size, said in ((MIN_UNPACK_ALLOWANCE + 1, "would unpack to 67 MB"), (1000, "sizes disagree")):
        with pytest.raises(LogError, match=said):
            read_log(one_chunk(tmp_path / "log.mcap", size, compression), column_map(["F=/wrench.force.z[N]"]))


@pytest.mark.parametrize(
    ("text", "said"),
    [
        ("[" * 100_000, "nested too deeply"),
        (f'{{"z": {10**400}}}', "a number of more than 300 digits"),
        ('{"z": 1e308}', r"is 1e\+308 in all messages, expected numbers"),
    ],
)
def test_json_that_means_harm_is_refused_in_a_sentence(tmp_path: Path, text: str, said: str):
    path = tmp_path / "log.mcap"
    with path.open("wb") as file:
        writer = Writer(file)
        writer.start(library="robot's own")
        channel = writer.register_channel("/wrench", "json", writer.register_schema("W", "jsonschema", b"{}"))
        for k in range(3):
            writer.add_message(channel, k, text.encode(), k)
        writer.finish()
    with pytest.raises(LogError, match=said):
        read_log(path, column_map(["F=/wrench.z[N]"]))


def test_a_pipe_is_not_waited_for(tmp_path: Path):
    os.mkfifo(tmp_path / "log.mcap")
    with pytest.raises(LogError, match="a pipe, socket or device"):
        read_log(tmp_path / "log.mcap")


def many_messages(path: Path, count: int, chunks: int) -> int:
    """A file of `chunks` chunks with `count` messages of three bytes each; gives what a chunk unpacks to."""
    schema = encode_record(Schema(id=1, name="W", encoding="jsonschema", data=b"{}"))
    channel = encode_record(Channel(id=1, topic="/wrench", message_encoding="json", metadata={}, schema_id=1))
    message = encode_record(Message(channel_id=1, log_time=1, publish_time=1, sequence=0, data=b"{ }"))
    content = schema + channel + message * count
    packed = zstandard.ZstdCompressor().compress(content)
    chunk = encode_record(Chunk("zstd", packed, 1, 1, zlib.crc32(content), len(content)))
    front = MCAP_MAGIC + encode_record(Header("", "robot's own"))
    path.write_bytes(front + chunk * chunks + encode_record(DataEnd(0)) + encode_record(Footer(0, 0, 0)) + MCAP_MAGIC)
    return len(content)


@pytest.mark.skipif(not sys.platform.startswith("linux"), reason="memory is read from /proc")
@pytest.mark.parametrize(("name", "most"), [("/other", 1.0), ("/wrench", 3.0)])
def test_what_unpacks_to_many_small_messages_takes_little_more_memory_than_it_unpacks_to(
    tmp_path: Path, name: str, most: float
):
    chunks, columns = 4, column_map([f"F={name}.z[N]"])
    many_messages(tmp_path / "log.mcap", 10, 1)
    read_topics(tmp_path / "log.mcap", columns)
    size = many_messages(tmp_path / "log.mcap", 150_000, chunks)
    with growth() as grown:
        (topic,), _ = read_topics(tmp_path / "log.mcap", columns)
        assert grown() < most * chunks * size
    assert len(topic.times) == chunks * 150_000 and len(topic.data) in (0, len(topic.times))


def test_a_chunk_that_would_not_fit_into_memory_is_refused_however_large_its_file_is(tmp_path: Path):
    packed = zstandard.ZstdCompressor().compress(b"")
    for largest in (MAX_CHUNK_BYTES, 2**26):
        chunk = Chunk("zstd", packed, 0, 0, 0, largest + 1)
        with pytest.raises(ValueError, match=f"expected chunks of at most {largest / 1e6:.0f} MB"):
            decompress_chunk(chunk, 2**40, largest)


def test_a_message_shorter_than_its_own_head_is_refused(tmp_path: Path):
    content = bytes([Opcode.MESSAGE]) + (3).to_bytes(8, "little") + bytes(60)
    chunk = encode_record(Chunk("", content, 0, 0, 0, len(content)))
    (tmp_path / "log.mcap").write_bytes(MCAP_MAGIC + encode_record(Header("", "robot's own")) + chunk + MCAP_MAGIC)
    with pytest.raises(LogError, match="a message is cut short"):
        read_topics(tmp_path / "log.mcap", {})
