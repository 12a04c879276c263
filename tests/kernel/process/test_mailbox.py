"""The rings between a simulation and another process: order, waiting, loss."""

import os
import subprocess
import sys
import threading
import time
from collections.abc import Iterator

import numpy as np
import pytest

from twin.kernel.process.mailbox import CAPACITY, GIVE_UP_TAG, Mailbox

FIRST_ENTRIES = """
import os, sys
from twin.kernel.process.mailbox import Mailbox
box = Mailbox(os.memfd_create("box"), 2, 3)
read = []
sys.addaudithook(lambda event, given: read.append(given[0]) if event in ("open", "import", "ctypes.dlopen") else None)
box.commands.put(0, [0.0, 0.0, 0.0])
box.samples.pop(0.001)
print(read)
"""


@pytest.fixture
def ends() -> Iterator[tuple[Mailbox, Mailbox]]:
    """Both ends of a mailbox: two mappings of one file, as of two processes."""
    fd = os.memfd_create("test mailbox")
    yield Mailbox(fd, 2, 3), Mailbox(fd, 2, 3)
    os.close(fd)


def test_entries_arrive_in_order_with_tick_tag_and_time(ends: tuple[Mailbox, Mailbox]):
    here, there = ends
    before = time.monotonic_ns()
    assert [here.samples.put(k, [k, -k], tag=7 + k) for k in range(3)] == [1, 2, 3]
    found = list(iter(there.samples.pop, None))
    assert [(one.number, one.tick, one.tag) for one in found] == [(1, 0, 7), (2, 1, 8), (3, 2, 9)]
    assert [one.values.tolist() for one in found] == [[0.0, 0.0], [1.0, -1.0], [2.0, -2.0]]
    assert before <= found[0].time <= found[2].time <= time.monotonic_ns()
    assert there.samples.pop() is None


def test_the_two_rings_are_apart(ends: tuple[Mailbox, Mailbox]):
    here, there = ends
    here.samples.put(0, [1.0, 2.0])
    there.commands.put(5, [1.0, np.nan, 3.0], GIVE_UP_TAG)
    command = here.commands.pop()
    assert command is not None and there.samples.pop() is not None
    assert (command.tick, command.tag) == (5, GIVE_UP_TAG)
    np.testing.assert_array_equal(command.values, [1.0, np.nan, 3.0])


def test_a_late_reader_loses_the_oldest_entries_and_counts_them(ends: tuple[Mailbox, Mailbox]):
    here, there = ends
    for k in range(CAPACITY + 10):
        here.samples.put(k, [k, 0.0])
    heads, values = there.samples.pop_arrays()
    # one entry less than the capacity: the writer may be overwriting the oldest
    assert there.samples.lost == 11 and len(heads) == len(values) == CAPACITY - 1
    assert heads[0, 1] == values[0, 0] == 11 and heads[-1, 1] == values[-1, 0] == CAPACITY + 9
    assert there.samples.pop() is None


def test_a_sleeping_reader_is_woken(ends: tuple[Mailbox, Mailbox]):
    here, there = ends
    found = []
    reader = threading.Thread(target=lambda: found.append((here.commands.pop(60.0), time.monotonic_ns())))
    reader.start()
    time.sleep(0.1)
    there.commands.put(1, [0.0, 0.0, 0.0])
    reader.join(60.0)
    entry, read = found[0]
    assert entry is not None
    # it looks every 20 ms at the latest; woken it takes far less
    assert read - entry.time < 15e6


def test_the_first_entry_of_a_process_loads_nothing():
    # it took 20 ms, and under load longer than a robot may be silent
    done = subprocess.run([sys.executable, "-c", FIRST_ENTRIES], capture_output=True, text=True, check=True)
    assert done.stdout == "[]\n"


def test_values_of_another_shape_are_refused(ends: tuple[Mailbox, Mailbox]):
    with pytest.raises(ValueError, match="expected \\(3,\\)"):
        ends[0].commands.put(0, [1.0])


def test_a_closed_mailbox_is_seen_by_the_other_end(ends: tuple[Mailbox, Mailbox]):
    assert not ends[1].is_closed
    ends[0].close()
    assert ends[1].is_closed
