import os
import subprocess
import sys
from pathlib import Path

import pytest
from typer.testing import CliRunner

from twin.cache_folder import VARIABLE
from twin.cli.app import app


@pytest.mark.parametrize("words", [["--help"], ["drive", "--help"], ["sweep", "--help"], ["component", "--help"]])
def test_commands_are_listed_with_their_whole_first_sentences(words: list[str]):
    _, commands = CliRunner().invoke(app, words).stdout.split("\nCommands:\n")
    listed = " ".join(commands.split())
    assert "..." not in listed and listed.endswith(".")


def test_help_is_made_without_what_draws(tmp_path: Path):
    shown = (
        "import sys; sys.argv[1:] = ['--help']; from twin.cli import main\ntry: main()\nfinally: print([*sys.modules])"
    )
    nothing_kept = os.environ | {VARIABLE: str(tmp_path)}
    done = subprocess.run([sys.executable, "-c", shown], capture_output=True, text=True, env=nothing_kept)
    assert "run        Run experiments and record them." in done.stdout
    assert "'rich'" not in done.stdout and "'pydantic'" not in done.stdout
