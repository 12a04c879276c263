from itertools import pairwise
from typing import NamedTuple

import numpy as np
from hypothesis import given
from hypothesis import strategies as st
from mcap.data_stream import RecordBuilder
from mcap.records import MessageIndex

from twin.recording.pending import Pending
from twin.recording.weave import LARGEST_CHUNK, Woven, woven


class Block(NamedTuple):
    """Records (n, stride) of one channel, and their times (n,)."""

    channel: int
    times: np.ndarray
    records: np.ndarray


def together(several: list[Block]) -> Woven:
    pending = Pending()
    for block in several:
        pending.put(*block)
    return woven(pending)


@st.composite
def blocks(draw: st.DrawFn) -> Block:
    """Records that name their channel, time and place, so that each can be told from all others."""
    channel = draw(st.integers(1, 5))
    times = np.array(sorted(draw(st.lists(st.integers(0, 20), min_size=1, max_size=8))))
    stride = draw(st.integers(3, 40))
    records = np.zeros((len(times), stride), dtype=np.uint8)
    records[:, 0], records[:, 1], records[:, 2] = channel, times, np.arange(len(times))
    return Block(channel, times, records)


def in_order(several: list[Block]) -> list[tuple[int, int, bytes]]:
    """(time, channel, record) of all messages, by time, then by block."""
    found = [
        (int(time), block.channel, bytes(record))
        for block in several
        for time, record in zip(block.times, block.records, strict=True)
    ]
    return sorted(found, key=lambda message: message[0])


@given(st.lists(blocks(), min_size=1, max_size=6))
def test_weaving_orders_records_by_time_then_by_block_and_loses_none(several: list[Block]) -> None:
    weave, expected = together(several), in_order(several)
    assert weave.content.tobytes() == b"".join(record for _, _, record in expected)
    assert weave.begin == expected[0][0]


@given(st.lists(blocks(), min_size=1, max_size=6), st.integers(1, 10**15), st.integers(1, 255))
def test_what_is_remembered_of_one_slice_fits_the_next(several: list[Block], later: int, mark: int) -> None:
    """Of the same shape, but at other times and with other numbers in it."""
    together(several)
    following = [Block(b.channel, b.times + later, b.records ^ np.uint8(mark)) for b in several]
    weave, expected = together(following), in_order(following)
    assert weave.content.tobytes() == b"".join(record for _, _, record in expected)
    assert (weave.begin, weave.begin + weave.pieces[-1].end) == (expected[0][0], expected[-1][0])


# mostly several pieces: 10 to 60 records of up to 100 kB
@given(st.lists(st.integers(1, 100_000), min_size=10, max_size=60), st.integers(1, 7))
def test_pieces_are_the_whole_in_order_and_never_cut_a_tick(lengths: list[int], per_tick: int) -> None:
    several = [
        Block(1, np.array([k // per_tick]), np.zeros((1, length), dtype=np.uint8)) for k, length in enumerate(lengths)
    ]
    pieces = together(several).pieces
    bounds = [0, *np.cumsum(lengths).tolist()]
    assert [piece.content.start for piece in pieces] == [0, *(piece.content.stop for piece in pieces[:-1])]
    assert pieces[-1].content.stop == bounds[-1]
    assert all(piece.content.start in bounds for piece in pieces)
    assert all(before.end < after.start for before, after in pairwise(pieces))
    # a cut moves back to the start of its tick, which adds at most one tick to the piece after it
    longest = LARGEST_CHUNK + per_tick * max(lengths)
    assert all(piece.content.stop - piece.content.start <= longest for piece in pieces)


@given(st.lists(blocks(), min_size=1, max_size=6), st.integers(0, 1000))
def test_message_indexes_are_those_that_mcap_writes(several: list[Block], shift: int) -> None:
    weave, expected = together(several), in_order(several)
    (piece,) = weave.pieces
    starts = np.cumsum([shift, *(len(record) for _, _, record in expected)]).tolist()
    indexes = piece.indexes(weave.begin, shift)
    assert set(indexes) == {channel for _, channel, _ in expected}
    for channel, index in indexes.items():
        builder = RecordBuilder()
        entries = [(time, start) for (time, own, _), start in zip(expected, starts, strict=False) if own == channel]
        MessageIndex(channel, entries).write(builder)
        assert index == builder.end()


@given(st.lists(st.integers(40_000, 100_000), min_size=10, max_size=30))
def test_indexes_of_a_later_piece_count_from_its_own_first_byte(lengths: list[int]) -> None:
    """A chunk is decompressed by itself: where it begins in the weave does not matter to its index."""
    several = [Block(1, np.array([k]), np.full((1, length), k, dtype=np.uint8)) for k, length in enumerate(lengths)]
    weave = together(several)
    assert len(weave.pieces) > 1
    for piece in weave.pieces:
        chunk = weave.content[piece.content]
        numbers, starts = np.unique(chunk, return_index=True)
        builder = RecordBuilder()
        MessageIndex(1, list(zip(numbers.tolist(), starts.tolist(), strict=True))).write(builder)
        assert piece.indexes(weave.begin, 0) == {1: builder.end()}
