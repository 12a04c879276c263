from itertools import pairwise

import numpy as np
from hypothesis import given
from hypothesis import strategies as st
from mcap.data_stream import RecordBuilder
from mcap.records import MessageIndex

from twin.recording.chunks import LARGEST_CHUNK, Messages, RecordBlock, merged, message_indexes, pieces


@st.composite
def blocks(draw: st.DrawFn) -> RecordBlock:
    """Records that name their channel, time and place, so that each can be told from all others."""
    channel = draw(st.integers(1, 5))
    times = np.array(sorted(draw(st.lists(st.integers(0, 20), min_size=1, max_size=8))))
    stride = draw(st.integers(3, 40))
    records = np.zeros((len(times), stride), dtype=np.uint8)
    records[:, 0], records[:, 1], records[:, 2] = channel, times, np.arange(len(times))
    return RecordBlock(channel, times, records)


@given(st.lists(blocks(), min_size=1, max_size=6))
def test_merging_orders_records_by_time_then_by_block_and_loses_none(several: list[RecordBlock]) -> None:
    timed = [pair for block in several for pair in zip(block.times, map(bytes, block.records), strict=True)]
    expected = sorted(timed, key=lambda pair: pair[0])
    messages = merged(several)
    assert messages.content.tobytes() == b"".join(record for _, record in expected)
    found = [messages.content[a:b].tobytes() for a, b in pairwise(messages.offsets)]
    assert found == [record for _, record in expected]
    assert messages.times.tolist() == [time for time, _ in expected]
    assert messages.channels.tolist() == [record[0] for record in found]


# mostly several pieces: 10 to 60 records of up to 100 kB
@given(st.lists(st.integers(1, 100_000), min_size=10, max_size=60), st.integers(1, 7))
def test_pieces_are_the_whole_in_order_and_never_cut_a_tick(lengths: list[int], per_tick: int) -> None:
    offsets = np.concatenate([[0], np.cumsum(lengths)])
    content = np.arange(offsets[-1]).astype(np.uint8)
    times = np.arange(len(lengths)) // per_tick
    whole = Messages(content, times, np.ones(len(lengths), dtype=np.int64), offsets)
    parts = list(pieces(whole))
    assert b"".join(part.content.tobytes() for part in parts) == content.tobytes()
    assert all(part.offsets[-1] == len(part.content) for part in parts)
    assert all(before.times[-1] < after.times[0] for before, after in pairwise(parts))
    # a cut moves back to the start of its tick, which adds at most one tick to the piece after it
    assert all(len(part.content) <= LARGEST_CHUNK + per_tick * max(lengths) for part in parts)


@given(st.lists(blocks(), min_size=1, max_size=6), st.integers(0, 1000))
def test_message_indexes_are_those_that_mcap_writes(several: list[RecordBlock], shift: int) -> None:
    messages = merged(several)
    for channel, index in message_indexes(messages, shift).items():
        own = [i for i, c in enumerate(messages.channels) if c == channel]
        builder = RecordBuilder()
        entries = [(int(messages.times[i]), int(messages.offsets[i]) + shift) for i in own]
        MessageIndex(channel, entries).write(builder)
        assert index == builder.end()
