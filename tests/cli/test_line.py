"""Command lines from beginning to end."""

import os
from pathlib import Path

from tests.command_line import twin


def test_the_help_fits_the_terminal(tmp_path: Path):
    wide = twin("--help", cwd=tmp_path).stdout
    narrow = twin("--help", cwd=tmp_path, env=os.environ | {"COLUMNS": "60"}).stdout
    assert max(map(len, narrow.splitlines())) <= 60 < max(map(len, wide.splitlines())) <= 80
    assert wide.split() == narrow.split()
