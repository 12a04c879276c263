"""Studies as commands: found by their files, asked with the options that their arguments say."""

import json
from pathlib import Path

import pytest
import typer
from twin.cli.studies import study_command
from twin.cli.study_files import study_file, study_names
from typer.testing import CliRunner

from twin import studies as package
from twin.cli import studies as made
from twin.cli import study_files
from twin.cli.app import Commands, app
from twin.errors import ComponentFailed

STUDY = '''
from collections.abc import Sequence
from pathlib import Path
from typing import Annotated

from twin.errors import ComponentFailed, InputRefused
from twin.studies.answer import Answer
from twin.studies.command import Argument, Asked, Option, study
from twin.studies.steps import Say


def _look(asked: Asked) -> None:
    if asked["word"] == "early":
        raise InputRefused("looked at first")


@study(before=[_look], on_failure=lambda asked: "Kept until then: nothing.")
def echo(
    word: Annotated[str, Argument("What is said.", "WORD")],
    say: Say,
    more: Annotated[Sequence[str], Option("Said, too.", "WORD", "--and")] = (),
    loud: Annotated[bool, Option("In capitals.")] = False,
    count: Annotated[int, Option("How often.", "N", least=1, most=3)] = 1,
) -> Answer:
    """Say something again.

    Example: twin echo word

    Raises:
        ComponentFailed: the word is `fail`.
    """
    if word == "fail":
        raise ComponentFailed("it failed")
    text = " ".join([word, *more] * count)
    return Answer(text.upper() if loud else text, {"more": more})
'''


@pytest.fixture(autouse=True)
def echo(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """A study in a file of a folder of its own."""
    (tmp_path / "echo.py").write_text(STUDY)
    monkeypatch.setattr(study_files, "FOLDER", tmp_path)
    monkeypatch.setattr(made, "FOLDER", tmp_path)
    monkeypatch.setattr(package, "__path__", [*package.__path__, str(tmp_path)])


def asked(*words: str) -> str:
    done = CliRunner().invoke(app, ["echo", *words], catch_exceptions=False)
    assert done.exit_code == 0, done.output
    return done.stdout.rstrip("\n")


def test_a_file_that_is_there_is_a_command_after_those_of_twin(tmp_path: Path):
    command = typer.main.get_command(app)
    assert isinstance(command, Commands)
    assert study_names() == ["echo"] and study_file("echo") == tmp_path / "echo.py"
    assert command.list_commands(None) == [*Commands.NAMES, "echo"]
    assert command.listed("echo").help.startswith("Say something again.")


def test_its_arguments_are_the_options(monkeypatch: pytest.MonkeyPatch):
    monkeypatch.setenv("COLUMNS", "80")
    assert asked("a", "--and", "b", "--and", "c", "--count", "2", "--loud") == "A B C A B C"
    # a flag has no other that says no, and what is left out is an empty sequence
    assert "--no-loud" not in asked("--help") and json.loads(asked("a", "--json")) == {"more": []}


def test_help_is_the_docstring_without_what_is_for_programs():
    assert "Example: twin echo word" in asked("--help") and "Raises" not in asked("--help")


@pytest.mark.parametrize("words", [["a", "--count", "0"], ["a", "--count", "4"], []])
def test_bounds_and_missing_arguments_are_refused(words: list[str]):
    assert CliRunner().invoke(app, ["echo", *words]).exit_code == 2


def test_what_is_asked_is_looked_at_before_the_study_begins():
    done = CliRunner().invoke(app, ["echo", "early"])
    assert str(done.exception) == "looked at first"


def test_a_component_that_fails_leaves_a_word_about_what_is_kept():
    with pytest.raises(ComponentFailed, match=r"^it failed\nKept until then: nothing\.$"):
        study_command("echo")(word="fail", more=None, loud=False, count=1, as_json=False)
