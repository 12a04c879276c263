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

# small enough that little is lost with the last one, large enough to compress; before compression, bytes
LARGEST_CHUNK = 256 * 1024
# of a log time and an offset in an index, bytes
ENTRY = 16
KEPT, KEPT_MESSAGES = 32, 5000
"""So many weaves of so many messages at most are remembered: a few MB."""


@dataclass(frozen=True)
class RecordBlock:
    """Message records of one channel.

    Attributes:
        channel: its number.
        times: log times, ns, (n,) int64, ascending.
        records: (n, stride) uint8.
    """

    channel: int
    times: np.ndarray
    records: np.ndarray


class Shape(NamedTuple):
    """What a weave asks of a block: its channel, how many its records are, and their length in bytes."""

    channel: int
    messages: int
    stride: int


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


@dataclass(frozen=True)
class Weave:
    """How the records of some blocks go in between each other; those of one time stay in the order of the blocks.

    Attributes:
        begin: log time of the first message, ns.
        size: bytes of all records.
        places: of each block, the bytes at which its records start, (n,) int64.
        pieces: chunks of about `LARGEST_CHUNK` bytes at most, cut between ticks: whatever of them survives, every
            topic ends at the same tick.
    """

    begin: int
    size: int
    places: tuple[np.ndarray, ...]
    pieces: tuple[Piece, ...]

    def woven(self, blocks: Sequence[RecordBlock]) -> np.ndarray:
        """The records of the `blocks` that this was made for, one after another, (size,) uint8."""
        content = np.empty(self.size, dtype=np.uint8)
        for block, places in zip(blocks, self.places, strict=True):
            windows = record_windows(content, block.records.shape[1])
            # as one opaque item each, numpy moves whole records
            windows[places] = block.records.view(windows.dtype)[:, 0]
        return content


def weave_of(blocks: Sequence[RecordBlock]) -> Weave:
    """How `blocks`, of at least one message, are woven."""
    shapes = tuple(Shape(block.channel, *block.records.shape) for block in blocks)
    times = np.concatenate([block.times for block in blocks])
    begin = times.min()
    made = _kept if len(times) <= KEPT_MESSAGES else _kept.__wrapped__
    size, places, pieces = made(shapes, (times - begin).tobytes())
    return Weave(int(begin), size, places, pieces)


@lru_cache(KEPT)
def _kept(shapes: tuple[Shape, ...], times: bytes) -> tuple[int, tuple[np.ndarray, ...], tuple[Piece, ...]]:
    """Size, places and pieces of a weave; `times` (n,) int64 since its first message, of one block after another."""
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
    return int(offsets[-1]), tuple(np.split(places, np.cumsum(counts)[:-1])), pieces


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


def record_windows(content: np.ndarray, stride: int) -> np.ndarray:
    """View of content (bytes,) uint8 as an item of `stride` bytes from every byte on, (bytes - stride + 1,).

    Indexing it with offsets gathers or scatters records of one length from among records of other lengths.
    """
    return np.ndarray((max(0, len(content) - stride + 1),), f"V{stride}", content, strides=(1,))
