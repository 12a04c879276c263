"""The Python examples of docs/ssp.md run, and need no part of the robot."""

import os
import subprocess
import sys
from pathlib import Path

from tests.docs.code_blocks import blocks

ABOVE = {
    "cli", "report", "studies", "runs", "experiment", "faults", "controller", "monitor", "plant", "robot",
}  # fmt: skip
"""Folders of `twin/` that are not of the kernel."""


def test_two_fmus_are_run_without_loading_the_robot(root: Path):
    example = [block.text for block in blocks(root, "docs/ssp.md") if block.language == "python"]
    listed = 'import sys; print(*{name.split(".")[1] for name in sys.modules if name.startswith("twin.")})'
    done = subprocess.run(
        [sys.executable, "-c", "\n".join([*example, listed])],
        cwd=root, env=os.environ | {"PYTHONPATH": str(root)}, capture_output=True, text=True,
    )  # fmt: skip
    assert done.returncode == 0, done.stderr
    loaded = set(done.stdout.split())
    assert loaded and not loaded & ABOVE
