"""Ctrl-C wherever it falls: in a finalizer, where Python prints and forgets it, or between any two instructions."""

import os
import signal
import subprocess
import sys
import threading
from pathlib import Path

import pytest

from tests.studies.sweep.definitions import stiffnesses
from twin.studies.sweep.folder import kept
from twin.studies.sweep.interrupt import PATIENCE, raise_if_pressed, remembered
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
    with remembered():
        raise_if_pressed()
        # nothing happens where it falls
        os.kill(os.getpid(), signal.SIGINT)
        with pytest.raises(KeyboardInterrupt):
            raise_if_pressed()
        # the end of the sweep is not disturbed
        os.kill(os.getpid(), signal.SIGINT)
        raise_if_pressed()
    assert signal.getsignal(signal.SIGINT) is signal.default_int_handler


def test_what_was_pressed_last_of_all_is_not_lost():
    with pytest.raises(KeyboardInterrupt), remembered():
        os.kill(os.getpid(), signal.SIGINT)
    raise_if_pressed()


PRESSED_TWICE = """
import os, signal, sys
from twin.studies.sweep.interrupt import remembered

def press():
    os.kill(os.getpid(), signal.SIGINT)

def pressed_twice(moment):
    def trace(frame, event, argument):
        global lines
        if event == "line":
            lines += 1
            if lines == moment:
                press()
        return trace
    sys.settrace(trace)
    press()

# the second time at each line of what the first calls, and more
for moment in range(1, 60):
    lines = 0
    try:
        with remembered():
            pressed_twice(moment)
    except KeyboardInterrupt:
        if lines >= moment:
            print(moment)
    finally:
        sys.settrace(None)
"""
PRESSED_AGAIN = """
import os, signal
from twin.studies.sweep.interrupt import remembered

with remembered():
    for number in range({times}):
        os.kill(os.getpid(), signal.SIGINT)
    print("goes on", flush=True)
"""


def _said(code: str) -> subprocess.CompletedProcess[str]:
    return subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, timeout=60)


def test_two_at_any_two_moments_do_not_wait_for_each_other():
    said = _said(PRESSED_TWICE)
    assert said.returncode == 0, said.stderr
    moments = [int(line) for line in said.stdout.split()]
    assert 10 < len(moments) < 59 and moments == [*range(1, len(moments) + 1)]


def test_the_third_ends_the_process_whatever_it_is_doing():
    patient, over = (_said(PRESSED_AGAIN.format(times=times)) for times in (PATIENCE - 1, PATIENCE))
    # before the end nobody has asked whether it was pressed
    assert patient.stdout == "goes on\n" and "KeyboardInterrupt" in patient.stderr
    assert (over.returncode, over.stdout) == (130, "")
    assert over.stderr == "\ninterrupted; finished runs are kept\n"


def test_an_answer_of_somebody_else_is_left_alone():
    before = signal.signal(signal.SIGINT, signal.SIG_IGN)
    try:
        with remembered():
            os.kill(os.getpid(), signal.SIGINT)
            raise_if_pressed()
            assert signal.getsignal(signal.SIGINT) is signal.SIG_IGN
    finally:
        signal.signal(signal.SIGINT, before)


def test_another_thread_has_no_ctrl_c_to_remember():
    def work() -> None:
        with remembered():
            raise_if_pressed()

    thread = threading.Thread(target=work)
    thread.start()
    thread.join()
    assert signal.getsignal(signal.SIGINT) is signal.default_int_handler
