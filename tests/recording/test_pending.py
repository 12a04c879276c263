import numpy as np
from hypothesis import given
from hypothesis import strategies as st

from twin.recording.pending import ROOM, Pending, Shape
from twin.recording.weave import woven


@given(st.lists(st.integers(1, 2 * ROOM), min_size=1, max_size=6))
def test_its_memory_grows_and_keeps_what_is_in_it(lengths: list[int]) -> None:
    pending = Pending()
    records = [np.full((1, length), number, dtype=np.uint8) for number, length in enumerate(lengths)]
    for number, record in enumerate(records):
        pending.put(number, np.array([number]), record)
    assert pending.shapes == [Shape(number, 1, length) for number, length in enumerate(lengths)]
    assert pending.size == sum(lengths)
    assert woven(pending).content.tobytes() == b"".join(record.tobytes() for record in records)


def test_what_was_woven_is_not_there_a_second_time() -> None:
    pending = Pending()
    pending.put(1, np.array([5]), np.zeros((1, 40), dtype=np.uint8))
    woven(pending)
    assert (pending.size, pending.shapes, pending.times) == (0, [], [])


def test_room_that_nobody_adds_to_is_given_again() -> None:
    pending = Pending()
    at = pending.room(100)
    assert pending.room(10) == at
    assert pending.size == 0
