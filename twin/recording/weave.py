"""Blocks of messages woven into one content: in order of time across topics, cut into chunks, indexed.

Layout of an index: https://mcap.dev/spec#message-index-op0x07. What a weave is made of, numbers of messages and the
times between them, comes again slice after slice; what is in the messages does not matter to it.
"""

import struct
from collections.abc import Sequence
from dataclasses import dataclass
from functools import lru_cache
from itertools import pairwise
from typing import NamedTuple

import numpy as np
from mcap.opcode import Opcode

from twin.compiled.function import carray
from twin.compiled.memory import copy
from twin.compiled.native import entry
from twin.recording.pending import Pending, Shape

# small enough that little is lost with the last one, large enough to compress; before compression, bytes
LARGEST_CHUNK = 256 * 1024
# of a log time and an offset in an index, bytes
ENTRY = 16
KEPT, KEPT_MESSAGES = 32, 5000
"""So many weaves of so many messages at most are remembered: a few MB."""


@dataclass(frozen=True)
class Piece:
    """Consecutive messages of a weave that become a chunk. Times are those since the first message of the weave.

    Attributes:
        content: which bytes of it.
        start, end: log times of the first and of the last message, ns.
        entries: log times and offsets in this piece, of one channel after another, (n, 2) uint64.
        channels: of each channel its number, how its index begins, and where in the bytes of `entries` its own are.
    """

    content: slice
    start: int
    end: int
    entries: np.ndarray
    channels: tuple[tuple[int, bytes, slice], ...]

    def indexes(self, begin: int, shift: int) -> dict[int, bytes]:
        """Encoded MessageIndex records by channel.

        Built from arrays: mcap's own MessageIndex packs entry by entry, which would cost more than all else here.

        Args:
            begin: log time of the first message of the weave, ns.
            shift: bytes of the chunk that stand before the messages.
        """
        own = (self.entries + np.array([begin, shift], dtype="<u8")).tobytes()
        return {channel: head + own[where] for channel, head, where in self.channels}


class Woven(NamedTuple):
    """Records in between each other, in order of time; those of one time in the order of their blocks.

    Attributes:
        begin: log time of the first message, ns.
        content: the records, one after another, (bytes,) uint8.
        pieces: chunks of about `LARGEST_CHUNK` bytes at most, cut between ticks: whatever of them survives, every
            topic ends at the same tick.
    """

    begin: int
    content: np.ndarray
    pieces: tuple[Piece, ...]


def woven(pending: Pending) -> Woven:
    """The records of `pending`, of which there is at least one; there are none in it afterwards."""
    times = np.concatenate(pending.times)
    begin = times.min()
    made = _kept if len(times) <= KEPT_MESSAGES else _kept.__wrapped__
    weave = made(tuple(pending.shapes), (times - begin).tobytes())
    content = np.empty(pending.size, dtype=np.uint8)
    _scatter(content, pending.address, *weave.table)
    pending.clear()
    return Woven(int(begin), content, weave.pieces)


@entry("nothing", "int", "int", "integers", "int", "integers", "int")
def _scatter(content, source, blocks, number, places, messages):
    block, place = carray(blocks, 2 * number), carray(places, messages)
    k = 0
    for b in range(number):
        stride = block[2 * b + 1]
        for _ in range(block[2 * b]):
            copy(content + place[k], source, stride)
            source += stride
            k += 1


class _Weave:
    """How the records of some blocks go in between each other.

    Args:
        shapes: of the blocks.
        places: bytes at which records go, of one block after another, (n,) int64.

    Attributes:
        pieces: see `Woven`.
        table: what `_scatter` takes of it.
    """

    def __init__(self, shapes: Sequence[Shape], places: np.ndarray, pieces: tuple[Piece, ...]):
        self.pieces = pieces
        self._blocks, self._places = np.array([shape[1:] for shape in shapes], dtype=np.int64), places
        self.table = self._blocks.ctypes.data, len(shapes), places.ctypes.data, len(places)


@lru_cache(KEPT)
def _kept(shapes: tuple[Shape, ...], times: bytes) -> _Weave:
    """`times` (n,) int64 since the first message, of one block after another."""
    counts = [shape.messages for shape in shapes]
    since = np.frombuffer(times, dtype=np.int64)
    order = np.argsort(since, kind="stable")
    since = since[order]
    channels = np.repeat([shape.channel for shape in shapes], counts)[order]
    offsets = np.concatenate([[0], np.cumsum(np.repeat([shape.stride for shape in shapes], counts)[order])])
    places = np.empty(len(since), dtype=np.int64)
    places[order] = offsets[:-1]
    parts = -(-int(offsets[-1]) // LARGEST_CHUNK)
    targets = np.arange(1, parts) * int(offsets[-1]) // parts
    inside = np.searchsorted(offsets, targets, side="right") - 1
    bounds = np.unique([0, *np.searchsorted(since, since[inside]), len(since)])
    pieces = tuple(_piece(since[a:b], channels[a:b], offsets[a : b + 1]) for a, b in pairwise(bounds.tolist()))
    return _Weave(shapes, places, pieces)


def _piece(since: np.ndarray, channels: np.ndarray, offsets: np.ndarray) -> Piece:
    first, last = offsets[[0, -1]].tolist()
    entries = np.stack([since, offsets[:-1] - first], axis=1).astype("<u8")
    numbers, counts = np.unique(channels, return_counts=True)
    sizes = ENTRY * counts
    ends = np.cumsum(sizes)
    places = tuple(
        (number, struct.pack("<BQHI", Opcode.MESSAGE_INDEX, 6 + size, number, size), slice(end - size, end))
        for number, size, end in zip(numbers.tolist(), sizes.tolist(), ends.tolist(), strict=True)
    )
    in_turn = entries[np.argsort(channels, kind="stable")]
    return Piece(slice(first, last), int(since[0]), int(since[-1]), in_turn, places)
