"""Ctrl-C while the command line is being imported ends in one word and 130, at whatever import it comes."""

import subprocess
import sys

import pytest

RAISING = """
import sys
import twin.cli

class Interrupt:
    # called for each module that is not imported yet
    def __init__(self, at):
        self.left = at
    def find_spec(self, name, path=None, target=None):
        self.left -= 1
        if self.left == 0:
            raise KeyboardInterrupt
        return None

hook = Interrupt(int(sys.argv.pop(1)))
sys.meta_path.insert(0, hook)
try:
    twin.cli.main()
finally:
    if hook.left > 0:
        print("never", file=sys.stderr)
"""


@pytest.mark.parametrize("at", [1, 2, 3, 5, 8, 13, 21, 34, 55, 89, 144, 233])
def test_an_interrupt_at_any_import_is_one_word_and_130(at: int):
    done = subprocess.run(
        [sys.executable, "-c", RAISING, str(at), "runs", "--help"],
        capture_output=True,
        text=True,
        timeout=60,
        check=False,
    )
    if done.stderr.endswith("never\n"):
        assert at > 30 and done.returncode == 0
    else:
        assert (done.returncode, done.stderr) == (130, "interrupted\n")
