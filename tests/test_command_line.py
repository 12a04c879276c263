"""Commands that are called in the tests' own process."""

import os
import signal
import sys
from pathlib import Path

from tests.command_line import twin


def test_a_command_leaves_the_process_as_it_was(tmp_path: Path):
    def state() -> list[object]:
        files = (sys.stdin, sys.stdout, sys.stderr)
        handlers = [signal.getsignal(number) for number in signal.valid_signals()]
        return [sys.unraisablehook, sys.excepthook, sys.argv, files, handlers, dict(os.environ), os.getcwd()]

    before = state()
    assert twin("init", "here.toml", cwd=tmp_path).returncode == 0
    assert state() == before
