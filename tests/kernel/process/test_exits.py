"""C's `exit` in a process without a supervisor."""

import os
import subprocess
import sys
from pathlib import Path

import pytest

from tests.kernel.process.hostile import EXIT, Command
from twin.kernel.process.exits import EXIT_MESSAGE

pytestmark = pytest.mark.skipif(os.name != "posix", reason="POSIX has handlers of exit that can be removed")
START = "import ctypes, os, sys\nfrom twin.kernel.process.exits import report_exit\nc = ctypes.CDLL(None)\n"


def ended(code: str) -> tuple[int, str, str]:
    done = subprocess.run([sys.executable, "-c", START + code], capture_output=True, text=True, timeout=60)
    return done.returncode, done.stdout, done.stderr


@pytest.mark.parametrize("code", [0, 1, 3, 70])
def test_an_exit_in_the_block_is_an_error_message_and_exit_code_3(code: int):
    assert ended(f"print('done')\nwith report_exit(lambda: 'said'): c.exit({code})") == (3, "done\n", "said\n")


def test_a_message_that_fails_does_not_hide_the_exit():
    assert ended("with report_exit(lambda: 1 / 0): c.exit(0)")[0] == 3


@pytest.mark.parametrize("end", ["sys.exit(7)", "c.exit(7)", "raise SystemExit(7)"])
def test_an_exit_after_the_block_keeps_its_code(end: str):
    assert ended(f"for _ in range(3):\n    with report_exit(lambda: 'said'): pass\n{end}") == (7, "", "")


def test_a_python_exit_in_the_block_keeps_its_code():
    assert ended("with report_exit(lambda: 'said'): sys.exit(7)") == (7, "", "")


def test_a_forked_process_may_exit():
    code = "with report_exit(lambda: 'said'):\n    p = os.fork()\n    if p == 0: c.exit(5)\n"
    assert ended(code + "    print(os.waitstatus_to_exitcode(os.waitpid(p, 0)[1]))") == (0, "5\n", "")


@pytest.mark.slow
def test_a_drive_that_exits_in_the_command_s_own_process_fails_the_command(command: Command, drive: Path):
    done = command.run(drive, EXIT, "--isolate", "none")
    assert done.returncode == 3 and EXIT_MESSAGE in done.stderr
    assert "Recorded until then: x/run.mcap.partial" in done.stderr
