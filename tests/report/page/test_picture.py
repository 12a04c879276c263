"""A picture is drawn by the process that waits for it, and here if there is none, or if it does not get there."""

import os
import signal

import pytest

from twin.kernel.process import process as ahead
from twin.kernel.process.process import end_waiting, start_ahead
from twin.report.page import DRAW_JOB
from twin.report.page.picture import MAX_PICKLE_BYTES, drawing

HERE = "tests.report.page.drawings:"


@pytest.fixture
def pid():
    """Of a process that waits for something to draw; none is left at the end."""
    start_ahead(DRAW_JOB)
    process = ahead._waiting[DRAW_JOB]
    yield process.pid
    end_waiting()
    assert process.has_exit_status


def test_who_waits_draws(pid: int):
    with drawing(HERE + "sign", ("of", 1)) as content:
        assert content() == f"('of', 1) {pid}".encode()


def test_without_one_who_waits_it_is_drawn_here():
    with drawing(HERE + "sign", "it") as content:
        assert content() == f"it {os.getpid()}".encode()


@pytest.mark.parametrize("draw", ["sign_at_home", "die_abroad"])
def test_what_is_not_drawn_there_is_drawn_here(pid: int, draw: str):
    with drawing(HERE + draw, os.getpid()) as content:
        assert content() == f"at home {os.getpid()}".encode()


def test_one_that_was_killed_meanwhile_is_not_waited_for(pid: int):
    with drawing(HERE + "sign", "it") as content:
        os.kill(pid, signal.SIGKILL)
        assert content().startswith(b"it ")


def test_one_that_stands_still_is_not_waited_for_for_ever(pid: int, monkeypatch: pytest.MonkeyPatch):
    monkeypatch.setattr("twin.report.page.picture.DRAW_TIMEOUT", 0.2)
    os.kill(pid, signal.SIGSTOP)
    with drawing(HERE + "sign", "it") as content:
        assert content() == f"it {os.getpid()}".encode()


def test_what_is_too_large_to_be_handed_over_is_drawn_here(pid: int):
    with drawing(HERE + "sign", "it", MAX_PICKLE_BYTES + 1) as content:
        assert content() == f"it {os.getpid()}".encode()


def test_where_there_is_no_room_to_hand_it_over_it_is_drawn_here(pid: int, monkeypatch: pytest.MonkeyPatch):
    def refuse(*_: object, **__: object) -> None:
        raise OSError("No space left on device")

    monkeypatch.setattr("pickle.dump", refuse)
    with drawing(HERE + "sign", "it") as content:
        assert content() == f"it {os.getpid()}".encode()


def test_a_page_that_fails_leaves_no_process(pid: int):
    with pytest.raises(ZeroDivisionError), drawing(HERE + "sign", "it"):
        raise ZeroDivisionError
