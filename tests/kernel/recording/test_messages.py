"""Forms against protobuf's own decoder: what was filled in is what is read, and nothing else has changed."""

import pickle
import re
import struct
from pathlib import Path

import numpy as np
import pytest
from foxglove_schemas_protobuf.FrameTransform_pb2 import FrameTransform
from foxglove_schemas_protobuf.SceneUpdate_pb2 import SceneUpdate
from foxglove_schemas_protobuf.Vector3_pb2 import Vector3
from google.protobuf.descriptor_pb2 import FileDescriptorSet
from google.protobuf.descriptor_pool import DescriptorPool
from google.protobuf.internal.encoder import _VarintBytes
from google.protobuf.message_factory import GetMessageClass
from google.protobuf.timestamp_pb2 import Timestamp
from hypothesis import given
from hypothesis import strategies as st
from mcap.data_stream import RecordBuilder
from mcap.reader import make_reader
from mcap.records import Message
from mcap.writer import Writer as McapWriter
from mcap_protobuf.decoder import DecoderFactory

from twin.kernel.errors import RecordingDamageError
from twin.kernel.recording.messages import (
    BLANK_TIME,
    HEAD_SIZE,
    MAX_FIELD_SIZE,
    Field,
    MessageForm,
    Topic,
    blank_value,
    descriptor_fields,
    descriptor_set,
    descriptors_of,
    form_filling,
    message_layout,
    message_names,
    varint,
)
from twin.kernel.recording.reader import read
from twin.kernel.recording.writer import Writer

from .samples import DRIVE, ENCODER, PLANT, TF, TF_ROWS, TICK, field_lists

F_Z = Field("F_z", 1, "double", "N", "pressing force")


@pytest.mark.parametrize("name", ["", "1st", "p B", "p-B", "p.B", "_p"])
def test_a_field_name_that_protobuf_cannot_hold_is_refused(name: str) -> None:
    with pytest.raises(ValueError, match="field name"):
        Field(name, 1, "double", "m", "position")


def test_a_field_without_values_is_refused() -> None:
    with pytest.raises(ValueError, match="size is 0, expected 1 or more"):
        Field("p_B", 0, "double", "m", "position")


def test_a_kind_that_no_message_has_is_refused() -> None:
    with pytest.raises(ValueError, match="kind is 'float', expected one of"):
        Field("p_B", 3, "float", "m", "position")  # type: ignore[arg-type]


@pytest.mark.parametrize("name", ["", "/plant", "drive//1", "drive/", "drive.1"])
def test_a_topic_name_with_empty_words_or_dots_is_refused(name: str) -> None:
    with pytest.raises(ValueError, match="topic name"):
        Topic(name, (F_Z,), 1)


def test_a_topic_that_never_comes_round_is_refused() -> None:
    with pytest.raises(ValueError, match="period is 0 ticks"):
        Topic("scale", (F_Z,), 0)


@pytest.mark.parametrize("fields", [(), (F_Z, F_Z)])
def test_a_topic_needs_fields_of_different_names(fields: tuple[Field, ...]) -> None:
    with pytest.raises(ValueError, match="fields of different names"):
        Topic("scale", fields, 1)


TEMPERATURE = Field("T", 1, "double", "K", "deflection temperature")


@given(field_lists)
def test_the_schema_alone_tells_name_size_kind_unit_and_meaning(fields: tuple[Field, ...]) -> None:
    assert descriptor_fields("twin.Plant", descriptor_set("twin.Plant", fields)) == fields


@given(st.text(max_size=9))
def test_texts_of_an_fmu_with_line_ends_can_be_read_again(text: str) -> None:
    described = f"a\n{text}\x85"
    (field,) = descriptor_fields("twin.X", descriptor_set("twin.X", [Field("x", 1, "double", "1", described)]))
    assert field.meaning == re.sub(r"[\x00-\x1f\x7f-\x9f]", lambda found: repr(found[0])[1:-1], described)


def test_unit_and_meaning_are_the_comment_of_each_protobuf_field() -> None:
    file = FileDescriptorSet.FromString(descriptor_set("twin.Drive", DRIVE)).file[0]
    assert [location.leading_comments for location in file.source_code_info.location] == [
        "rad: motor angle",
        "rad/s: motor speed",
    ]


def test_topics_of_one_shape_share_a_message_type_and_others_do_not() -> None:
    topics = [Topic(f"drive/{leg}", DRIVE, 1) for leg in (1, 2, 3)]
    assert message_names([*topics, PLANT, ENCODER]) == ["twin.Drive"] * 3 + ["twin.Plant", "twin.Encoder"]


def test_a_drive_with_other_fields_has_a_message_type_of_its_own() -> None:
    odd = (*DRIVE, TEMPERATURE)
    topics = [Topic("drive/1", DRIVE, 1), Topic("drive/2", odd, 1), Topic("drive/3", DRIVE, 1)]
    assert message_names(topics) == ["twin.Drive", "twin.Drive2", "twin.Drive"]


def test_two_shapes_never_share_a_message_type() -> None:
    with pytest.raises(ValueError, match="topic Plant: type Plant has other fields already"):
        message_names([PLANT, Topic("Plant", DRIVE, 1)])


@pytest.mark.parametrize("name", ["twin.Drive", "twin.Plant"])
def test_a_schema_without_the_message_or_its_comments_is_refused(name: str) -> None:
    descriptors = FileDescriptorSet.FromString(descriptor_set("twin.Drive", DRIVE))
    descriptors.file[0].ClearField("source_code_info")
    with pytest.raises(ValueError, match=r"twin\.(Drive|Plant)"):
        descriptor_fields(name, descriptors.SerializeToString())


def test_a_field_of_absurd_size_is_refused_before_memory_is_asked_for() -> None:
    for size, fits in ((MAX_FIELD_SIZE, True), (MAX_FIELD_SIZE + 1, False)):
        field = Field("x", size, "double", "1", "x")
        descriptors = descriptor_set("twin.X", [field])
        if fits:
            assert descriptor_fields("twin.X", descriptors) == (field,)
            continue
        with pytest.raises(ValueError, match=r"field x of twin\.X is not one that twin writes"):
            descriptor_fields("twin.X", descriptors)


# up to the time at which a timestamp in nanoseconds ends, in the year 2262
times = st.integers(0, 2**63 - 1)


@given(times, st.floats(width=64), st.floats(width=64))
def test_protobuf_reads_every_time_and_number_that_was_filled_in(time: int, first: float, second: float):
    records = form_filling(1, TF).records(np.array([time]), 0, np.array([[first, second]]))
    message = FrameTransform.FromString(records[0, HEAD_SIZE:].tobytes())
    assert message.timestamp.ToNanoseconds() == time
    found = struct.pack("<ddd", message.translation.x, message.translation.y, message.translation.z)
    assert found == struct.pack("<ddd", second, first, second)
    assert message.child_frame_id == "platform"


@given(times, st.floats(allow_nan=False))
def test_a_message_says_what_protobuf_would_write_of_it(time: int, number: float):
    records = form_filling(1, TF).records(np.array([time]), 0, np.array([[number, number]]))
    stamp = Timestamp()
    stamp.FromNanoseconds(time)
    written = FrameTransform(
        timestamp=stamp, child_frame_id="platform", translation=Vector3(x=number, y=number, z=number)
    )
    assert FrameTransform.FromString(records[0, HEAD_SIZE:].tobytes()) == written


def test_another_reader_finds_every_message_at_its_time(finished: Path):
    with finished.open("rb") as file:
        reader = make_reader(file, validate_crcs=True, decoder_factories=[DecoderFactory()])
        found = [(m.log_time, m.sequence, p) for _, _, m, p in reader.iter_decoded_messages("/tf")]
    assert [(time, number) for time, number, _ in found] == [(20_000_000 * k, k) for k in range(len(TF_ROWS))]
    assert all(picture.timestamp.ToNanoseconds() == time for time, _, picture in found)
    assert [(p.translation.y, p.translation.x) for _, _, p in found] == [tuple(row) for row in TF_ROWS]


def test_a_column_without_a_blank_is_refused():
    example = FrameTransform(timestamp=BLANK_TIME, translation=Vector3(x=blank_value(0)))
    with pytest.raises(ValueError, match=r"form tf: columns \[1\] have no blank in the example"):
        form_filling(1, MessageForm("tf", example, 2, 1))


def test_a_form_without_columns_is_the_same_message_again(tmp_path: Path):
    with Writer(tmp_path / "run.mcap", [], TICK, {}, [MessageForm("scene", SceneUpdate(), 0, 1)]) as writer:
        writer.write("scene", 0, np.empty((2, 0)))
    with (tmp_path / "run.mcap").open("rb") as file:
        assert [m.data for _, _, m in make_reader(file).iter_messages()] == [b"", b""]


def test_a_form_needs_a_name_and_a_period():
    with pytest.raises(ValueError, match="topic name '/tf'"):
        MessageForm("/tf", SceneUpdate(), 0, 1)
    with pytest.raises(ValueError, match="period is 0 ticks"):
        MessageForm("tf", SceneUpdate(), 0, 0)


def test_pictures_that_went_missing_are_missed(tmp_path: Path):
    path = tmp_path / "run.mcap"
    with path.open("wb") as file:
        writer = McapWriter(file, enable_data_crcs=True)
        writer.start()
        drive = writer.register_schema("twin.Drive", "protobuf", descriptor_set("twin.Drive", DRIVE))
        writer.register_channel("/drive/1", "protobuf", drive)
        type_name = FrameTransform.DESCRIPTOR.full_name
        picture = writer.register_schema(type_name, "protobuf", descriptors_of(FrameTransform.DESCRIPTOR))
        channel = writer.register_channel("/tf", "protobuf", picture)
        for number in (0, 2):
            writer.add_message(channel, number, b"", number, number)
        writer.finish()
    with pytest.raises(RecordingDamageError, match="a chunk before which messages are missing"):
        read(path)


VALUES = {
    "double": st.floats(width=64),
    # every whole number up to this is a float64
    "int": st.integers(-(2**53), 2**53).map(float),
    "bool": st.sampled_from([0.0, 1.0]),
}


@given(st.data(), field_lists, st.integers(1, 65535), st.integers(0, 2**32 - 1), st.integers(0, 2**63 - 1))
def test_protobuf_decodes_every_value_bit_for_bit_from_a_genuine_message_record(
    data: st.DataObject, fields: tuple[Field, ...], channel: int, sequence: int, time: int
) -> None:
    row = [data.draw(VALUES[field.kind]) for field in fields for _ in range(field.size)]
    layout = message_layout(channel, fields)
    record = layout.filling.records(np.array([time]), sequence, np.array([row])).tobytes()

    body = record[31:]
    builder = RecordBuilder()
    Message(channel, time, body, time, sequence).write(builder)
    assert builder.end() == record

    file = FileDescriptorSet.FromString(descriptor_set("twin.Plant", fields)).file[0]
    pool = DescriptorPool()
    pool.Add(file)
    message = GetMessageClass(pool.FindMessageTypeByName("twin.Plant")).FromString(body)
    decoded: list[float] = []
    for field in fields:
        value = getattr(message, field.name)
        decoded += value if field.size > 1 else [value]
    assert np.array(decoded, dtype=float).tobytes() == np.array(row).tobytes()


@pytest.mark.parametrize("count", [np.nan, np.inf, 0.5, 2.0**63])
def test_a_count_that_is_no_whole_number_of_64_bits_is_refused(count: float) -> None:
    fields = (Field("count_m", 1, "int", "1", "motor encoder"),)
    with pytest.raises(ValueError, match="field count_m holds whole numbers"):
        message_layout(1, fields).filling.records(np.array([0]), 0, np.array([[count]]))


@given(st.integers(0, 2**64 - 1))
def test_varints_are_those_of_protobuf(number: int) -> None:
    assert varint(number) == _VarintBytes(number)


def test_fields_that_json_would_call_alike_have_names_of_their_own() -> None:
    fields = tuple(Field(name, 1, "double", "1", "") for name in ("theta_m", "thetaM", "theta_M", "A", "A_", "b"))
    file = FileDescriptorSet.FromString(descriptor_set("twin.Plant", fields)).file[0]
    pool = DescriptorPool()
    # refuses two of one name
    pool.Add(file)
    names = [field.json_name for field in pool.FindMessageTypeByName("twin.Plant").fields]
    assert len({*names}) == len(fields) and names[-1] == "b"


def test_a_layout_that_another_process_gets_fills_records_as_it_did_here():
    fields = (Field("p", 2, "double", "m", "a place"),)
    layout = message_layout(3, fields)
    times, rows = np.array([1, 2]), np.array([[0.5, 1.5], [2.5, 3.5]])
    expected = layout.filling.records(times, 0, rows)
    elsewhere = pickle.loads(pickle.dumps(layout))
    assert elsewhere.filling._template_at != layout.filling._template_at
    np.testing.assert_array_equal(elsewhere.filling.records(times, 0, rows), expected)
