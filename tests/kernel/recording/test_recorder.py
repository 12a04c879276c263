"""Blocks: slices put together again."""

import numpy as np
from hypothesis import given
from hypothesis import strategies as st

from twin.kernel.cosim.observers import TickEvent
from twin.kernel.recording.recorder import RowBlock

SIZE = 12


@given(st.sampled_from([1, 2, 3, 4, 6, 12]))
def test_blocks_are_the_same_however_the_run_was_sliced(length: int):
    rows = np.arange(3.0 * 2 * SIZE).reshape(-1, 3)
    block, blocks = RowBlock(SIZE, 3), []
    for first in range(0, len(rows), length):
        block.add(rows[first : first + length], [TickEvent(first, "INFO", str(k), "x") for k in (1, 2)])
        if block.is_full:
            blocks.append((block.first, block.rows, [event.tick for event in block.events]))
            block = RowBlock(SIZE, 3, block.first + SIZE)
    assert [first for first, _, _ in blocks] == [0, SIZE]
    assert np.array_equal(np.concatenate([each for _, each, _ in blocks]), rows)
    assert [tick for _, _, ticks in blocks for tick in ticks] == sorted([*range(0, 2 * SIZE, length)] * 2)
    assert len(block.rows) == len(block.events) == 0
