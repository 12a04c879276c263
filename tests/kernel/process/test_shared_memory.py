"""A word in shared memory that one side sets and the other waits for."""

import platform
import threading
import time

import numpy as np
import pytest

from twin.kernel.errors import InputRefused
from twin.kernel.process.shared_memory import is_zombie, set_and_wake, syscall_numbers, timespec, wait_once


def test_who_sleeps_on_a_word_is_woken_when_it_is_set():
    words, patience, calls = np.zeros(2, dtype=np.int32), timespec(60.0), syscall_numbers()
    word, asleep = words.ctypes.data, words[1:].ctypes.data
    found: list[bool] = []
    sleeper = threading.Thread(
        target=lambda: found.append(wait_once(calls.ctypes.data, word, asleep, 7, patience.ctypes.data))
    )
    began = time.monotonic()
    sleeper.start()
    while not words[1]:
        time.sleep(0.001)
    set_and_wake(calls.ctypes.data, word, asleep, 7)
    sleeper.join(60.0)
    assert found == [True]
    # compiling aside; without the call it would sleep for 60 s
    assert time.monotonic() - began < 30.0


def test_patience_ends_without_an_answer():
    words, patience, calls = np.zeros(2, dtype=np.int32), timespec(0.05), syscall_numbers()
    assert not wait_once(calls.ctypes.data, words.ctypes.data, words[1:].ctypes.data, 7, patience.ctypes.data)


def test_a_process_that_is_no_child_counts_as_not_ended():
    info, calls = np.zeros(128, dtype=np.uint8), syscall_numbers()
    assert not is_zombie(calls.ctypes.data, 1, info.ctypes.data)


def test_a_time_is_split_into_seconds_and_nanoseconds():
    assert timespec(2.25).tolist() == [2, 250_000_000]


def test_an_unknown_processor_is_refused_with_a_way_out(monkeypatch: pytest.MonkeyPatch):
    monkeypatch.setattr(platform, "machine", lambda: "abacus")
    with pytest.raises(InputRefused, match="use --isolate run"):
        syscall_numbers()
