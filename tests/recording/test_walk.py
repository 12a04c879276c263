"""Records found in bytes are those that were put there."""

import struct

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from mcap.opcode import Opcode

from tests.recording.forgery import FRONT, joined
from twin.recording.walk import CHANNEL, LENGTH, OPCODE, PLACE, SEQUENCE, Records

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
        assert (row[OPCODE], row[LENGTH]) == (opcode, len(body))
        assert content[row[PLACE] + FRONT.size : row[PLACE] + FRONT.size + row[LENGTH]] == body
        expected = struct.unpack_from("<HI", body) if opcode == Opcode.MESSAGE else (-1, -1)
        assert (row[CHANNEL], row[SEQUENCE]) == expected


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
    found = Records(joined(written)).of(1, 2, 7, stride)
    assert found is not None and found.tobytes() == joined([written[0], written[2]])
    assert Records(joined(written)).of(1, 2, 6, stride) is None
    assert Records(joined([message(1, 7), message(1, 9)])).of(1, 2, 7, stride) is None
    with pytest.raises(ValueError, match="length"):
        Records(joined([message(1, 7), message(1, 8, b"1")])).of(1, 2, 7, stride)
