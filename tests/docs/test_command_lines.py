"""The command lines in the README's tables are commands that exist, with files that are there; all of them run."""

import re
import shlex
from pathlib import Path
from typing import Any

import click
import pytest

from tests.docs.workshop import Workshop
from twin.cli.app import twin_command

BEFORE = (
    "twin run fig4_force_position fig4_position fig4_imperfect fig4_imperfect_position pressing tapping rolling pushing"
)
"""What the table takes for granted: the runs that it compares."""
CODE = re.compile(r"`(twin [^`]*)`")
PYTHON = re.compile(r"`(from twin[^`]*)`")
SERVES = ("--live", "twin explore ")
"""Wait for a viewer or a browser; tests of their own have both."""
HOLDS_NOT = ("--tol", "twin falsify ")
"""Two runs that differ are compared; a requirement that can be violated is."""
FILES = re.compile(r"^(experiments|docs|examples)/")


def command_lines(root: Path) -> list[str]:
    """Those in the table rows of README.md, but for patterns with an ellipsis."""
    rows = [line for line in (root / "README.md").read_text().splitlines() if line.startswith("|")]
    # a table has | in a cell as \|
    return [found.replace("\\|", "|") for row in rows for found in CODE.findall(row) if "..." not in found]


def parsed(words: list[str], command: Any = None) -> None:
    """Read `words` as the command line they are, without carrying it out.

    Raises:
        click.UsageError: no such command or option, or a word too many or too few.
    """
    command = command or twin_command()
    context = command.make_context("twin", list(words))
    if hasattr(command, "commands"):
        _, inner, rest = command.resolve_command(context, [*context._protected_args, *context.args])
        parsed(rest, inner)


def test_every_command_line_of_the_readme_has_a_command_and_options_that_exist(root: Path):
    lines = command_lines(root)
    assert len(lines) > 25
    for line in lines:
        words = shlex.split(line)[1:]
        parsed(words)
        for word in words:
            assert not FILES.match(word) or (root / word).exists(), line


@pytest.mark.parametrize(
    "line", ["twin rnu a.toml", "twin run a.toml --boddy back", "twin sweep show", "twin check -j x"]
)
def test_a_command_line_that_is_none_is_noticed(line: str):
    with pytest.raises(click.UsageError):
        parsed(shlex.split(line)[1:])


def test_the_readmes_python_line_gives_an_array(root: Path, tmp_path: Path, force_position, monkeypatch):
    (line,) = PYTHON.findall((root / "README.md").read_text())
    (tmp_path / "results").mkdir()
    (tmp_path / "results" / "fig4_force_position").symlink_to(force_position.path.parent)
    monkeypatch.chdir(tmp_path)
    found: dict[str, object] = {}
    exec(line, found)
    assert found["F"].shape == (20001, 3)  # type: ignore[attr-defined]


@pytest.mark.endurance
def test_every_command_line_of_the_readme_works_one_after_the_other(root: Path, tmp_path: Path):
    workshop = Workshop(root, tmp_path)
    for line in [BEFORE, *command_lines(root)]:
        if not any(one in line for one in SERVES):
            workshop.twin(*shlex.split(line)[1:], expected=int(any(one in line for one in HOLDS_NOT)))
