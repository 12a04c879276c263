"""Ctrl-C in a finalizer, where Python prints and forgets it."""

import os
import signal
import threading
from pathlib import Path

import pytest

from tests.studies.sweep.definitions import stiffnesses
from twin.studies.sweep.folder import kept
from twin.studies.sweep.interrupt import remembered
from twin.studies.sweep.pool import Pool
from twin.studies.sweep.sweep import State, run_sweep


class Gone:
    """What is pressed while this is cleared away is lost."""

    def __del__(self) -> None:
        os.kill(os.getpid(), signal.SIGINT)


@pytest.mark.filterwarnings("ignore::pytest.PytestUnraisableExceptionWarning")
def test_a_sweep_ends_though_ctrl_c_was_swallowed(root: Path, tmp_path: Path):
    def show(state: State) -> None:
        if state.done:
            # swallowed here, in the middle of a sweep
            Gone()

    folder = tmp_path / "out"
    with pytest.raises(KeyboardInterrupt):
        run_sweep(
            stiffnesses(root, tmp_path, str([500 + number for number in range(2000)])), folder, Pool(1), show=show
        )
    assert 0 < len(kept(folder).rows) < 2000


def test_ctrl_c_is_what_it_was_before_afterwards():
    with remembered() as raise_if_pressed:
        raise_if_pressed()
        with pytest.raises(KeyboardInterrupt):
            os.kill(os.getpid(), signal.SIGINT)
        with pytest.raises(KeyboardInterrupt):
            raise_if_pressed()
    assert signal.getsignal(signal.SIGINT) is signal.default_int_handler


def test_an_answer_of_somebody_else_is_left_alone():
    before = signal.signal(signal.SIGINT, signal.SIG_IGN)
    try:
        with remembered() as raise_if_pressed:
            os.kill(os.getpid(), signal.SIGINT)
            raise_if_pressed()
            assert signal.getsignal(signal.SIGINT) is signal.SIG_IGN
    finally:
        signal.signal(signal.SIGINT, before)


def test_another_thread_has_no_ctrl_c_to_remember():
    def work() -> None:
        with remembered() as raise_if_pressed:
            raise_if_pressed()

    thread = threading.Thread(target=work)
    thread.start()
    thread.join()
    assert signal.getsignal(signal.SIGINT) is signal.default_int_handler
