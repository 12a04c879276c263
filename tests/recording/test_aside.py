import os
import threading
import time
from functools import partial

import pytest

from twin.recording import aside
from twin.recording.aside import Aside


@pytest.fixture(params=[1, 2], ids=["one core", "two cores"])
def either(request: pytest.FixtureRequest, monkeypatch: pytest.MonkeyPatch) -> Aside:
    monkeypatch.setattr(aside, "cores", lambda: request.param)
    return Aside()


@pytest.fixture
def apart(monkeypatch: pytest.MonkeyPatch) -> Aside:
    monkeypatch.setattr(aside, "cores", lambda: 2)
    return Aside()


def refuse() -> None:
    raise OSError("the disk is full")


def test_jobs_are_done_in_their_order(either: Aside) -> None:
    done: list[int] = []
    for number in range(100):
        either.begin(partial(done.append, number))
    either.wait()
    assert done == list(range(100))


def test_only_the_newest_job_may_still_be_going_on(apart: Aside) -> None:
    done: list[int] = []

    def slow(number: int) -> None:
        time.sleep(0.05)
        done.append(number)

    for number in range(3):
        apart.begin(partial(slow, number))
        assert done == list(range(number))
    apart.wait()


def test_where_there_is_a_second_processor_a_job_is_done_by_another_thread(either: Aside) -> None:
    threads: list[int] = []
    either.begin(lambda: threads.append(threading.get_ident()))
    either.wait()
    assert (threads != [threading.get_ident()]) == either._apart


@pytest.mark.skipif(not hasattr(os, "sched_setaffinity"), reason="elsewhere nobody tells")
def test_a_process_that_may_run_on_one_processor_has_no_thread() -> None:
    allowed = os.sched_getaffinity(0)
    os.sched_setaffinity(0, {min(allowed)})
    try:
        assert not Aside()._apart
    finally:
        os.sched_setaffinity(0, allowed)


def test_nobody_is_left_when_all_is_done_and_more_may_follow(apart: Aside) -> None:
    before = threading.active_count()
    done: list[int] = []
    for number in range(2):
        apart.begin(partial(done.append, number))
        assert threading.active_count() == before + 1
        apart.wait()
        assert threading.active_count() == before
    assert done == [0, 1]


@pytest.mark.parametrize("asked", [Aside.wait, Aside.check, lambda found: found.begin(lambda: None)])
def test_what_a_job_raises_is_raised_once_by_whatever_comes_next(apart: Aside, asked) -> None:
    apart.begin(refuse)
    with apart._newest:
        pass
    with pytest.raises(OSError, match="the disk is full"):
        asked(apart)
    apart.wait()


def test_an_interrupt_while_waiting_leaves_everything_to_be_waited_for(apart: Aside) -> None:
    done: list[int] = []
    held = threading.Event()

    def wait_and_note() -> None:
        held.wait()
        done.append(0)

    apart.begin(wait_and_note)
    # what is left of an interrupt that came before it was noted which job is the newest
    apart._newest = threading.Lock()
    threading.Timer(0.05, held.set).start()
    apart.wait()
    assert done == [0]
