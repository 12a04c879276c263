"""Ctrl-C at moments where Python itself would print it and go on, or end with a traceback."""

import os
import signal
import subprocess
import sys
import time

import pytest

LOST = """
import sys, time
from twin.kernel.process.interrupt import keep_interrupts

class Kept:
    def __del__(self):
        raise {error}

keep_interrupts()
try:
    Kept()
    # without the hook nobody would end this
    time.sleep(1.0)
    print("went on")
except KeyboardInterrupt:
    print("interrupted")
"""


def _said(error: str) -> subprocess.CompletedProcess[str]:
    return subprocess.run([sys.executable, "-c", LOST.format(error=error)], capture_output=True, text=True, timeout=60)


def test_an_interrupt_in_a_finaliser_ends_the_program_and_prints_nothing():
    said = _said("KeyboardInterrupt")
    assert (said.stdout, said.stderr) == ("interrupted\n", "")


def test_other_errors_of_a_finaliser_are_printed_as_ever():
    said = _said("ValueError('odd')")
    assert said.stdout == "went on\n" and "ValueError: odd" in said.stderr


@pytest.mark.skipif(os.name != "posix", reason="Ctrl-C is sent as a signal")
@pytest.mark.parametrize("moment", ["twin.cli.ahead", "twin.cli.app", "twin.cli.run"])
def test_ctrl_c_while_the_commands_are_imported_is_one_word(moment, tmp_path):
    # at a moment that no clock could hit
    interrupting = f"""
import os, signal, sys
class Ctrl:
    def find_spec(self, name, path=None, target=None):
        if name == {moment!r}:
            os.kill(os.getpid(), signal.SIGINT)
sys.meta_path.insert(0, Ctrl())
sys.argv = ["twin", "run", "fig4_position"]
from twin.cli import main
main()
"""
    said = subprocess.run(
        [sys.executable, "-c", interrupting], capture_output=True, text=True, timeout=60, cwd=tmp_path
    )
    assert (said.returncode, said.stdout, said.stderr) == (130, "", "interrupted\n")


@pytest.mark.skipif(os.name != "posix", reason="Ctrl-C is sent as a signal")
def test_a_waiting_main_thread_is_woken():
    code = "import threading, time\nfrom twin.kernel.process.interrupt import interrupt_main\n"
    code += "threading.Timer(0.1, interrupt_main).start()\ntime.sleep(30)"
    began = time.monotonic()
    said = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, timeout=60)
    assert said.returncode == -signal.SIGINT and time.monotonic() - began < 20.0
