import pickle

import numpy as np
import pytest
from google.protobuf.descriptor_pb2 import FileDescriptorSet
from google.protobuf.descriptor_pool import DescriptorPool
from google.protobuf.internal.encoder import _VarintBytes
from google.protobuf.message_factory import GetMessageClass
from hypothesis import given
from hypothesis import strategies as st
from mcap.data_stream import RecordBuilder
from mcap.records import Message

from twin.recording.layout import Field
from twin.recording.messages import message_layout, message_records, varint
from twin.recording.schema import descriptor_set

from .samples import field_lists

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
    record = message_records(layout, fields, np.array([time]), sequence, np.array([row])).tobytes()

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
        message_records(message_layout(1, fields), fields, np.array([0]), 0, np.array([[count]]))


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
    expected = message_records(layout, fields, times, 0, rows)
    elsewhere = pickle.loads(pickle.dumps(layout))
    assert elsewhere.filling._template_at != layout.filling._template_at
    np.testing.assert_array_equal(message_records(elsewhere, fields, times, 0, rows), expected)
