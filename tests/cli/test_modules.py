"""Commands that are imported when they are asked for."""

import subprocess
import sys

import pytest
import typer
from twin.cli.group import WHOLE

from twin.cli.app import Commands, app

USED = """
import sys
sys.argv = ["twin", *{words!r}]
from twin.cli import main
try:
    main()
except SystemExit:
    loaded = lambda name: {{"twin.cli." + name, f"twin.studies.{{name}}.study"}} & {{*sys.modules}}
    print(*sorted(filter(loaded, {names!r})), file=sys.stderr)
"""


@pytest.mark.parametrize("name", Commands.NAMES)
def test_what_the_list_says_of_a_command_is_what_it_says_itself(name: str, monkeypatch: pytest.MonkeyPatch):
    command = typer.main.get_command(app)
    assert isinstance(command, Commands)
    own = command.commands[name].get_short_help_str(WHOLE)
    # it is not the command itself that is asked
    monkeypatch.setattr(command, "commands", {})
    assert command.listed(name).get_short_help_str(WHOLE) == own != ""


@pytest.mark.parametrize(
    ("words", "imported"),
    [(["tune", "--help"], "tune"), (["--version"], ""), (["tnue"], ""), (["drive", "--help"], "drive")],
)
def test_only_the_command_that_is_asked_for_is_imported(words: list[str], imported: str):
    program = USED.format(words=words, names=Commands.NAMES)
    done = subprocess.run([sys.executable, "-c", program], capture_output=True, text=True)
    assert done.stderr.splitlines()[-1] == imported


def test_a_name_that_is_no_command_is_none():
    command = typer.main.get_command(app)
    assert isinstance(command, Commands)
    assert "progress" not in command.commands and command.commands.get("progress") is None
    assert list(command.commands) == list(Commands.NAMES) and len(command.commands) == len(Commands.NAMES)
