"""Command lines that are told by their words alone, before Typer, which takes longer to import than they all take.

What they print is kept (`twin.kept`), so that in the end they import hardly anything.
"""

import os
from collections.abc import Callable
from pathlib import Path

from twin.errors import InputRefused
from twin.kept import kept

_PARTS = ("compiled", "controller", "cosim", "monitor", "plant", "robot", "runs")
ROOMS = {"help": ("cli", "studies"), "schema": ("experiment", *_PARTS)}
"""Whose source these answers are made with."""


def answered(words: list[str]) -> int | None:
    """The exit code of the command line `words`, once it is carried out; None: Typer has to read it."""
    line = " ".join(words)
    # the shell asks for what may follow; or a word has spaces, or is none
    if "_TWIN_COMPLETE" in os.environ or line.split() != words or line not in ANSWERS:
        return None
    return ANSWERS[line]()


def print_help() -> int:
    """The help of `twin` itself."""
    print(kept("help", _help, lambda: "\n".join(_surroundings()), rooms=ROOMS["help"]))
    return 0


def schema() -> str:
    """The schema of the experiment file."""

    def made() -> str:
        from twin.experiment.json_schema import schema_text
        from twin.runs.assembly.declared import DECLARED

        return schema_text(DECLARED)

    return kept("schema", made, rooms=ROOMS["schema"])


def print_schema() -> int:
    """What `twin schema` prints."""
    print(schema(), end="")
    return 0


def list_drives(as_json: bool = False) -> int:
    """What `twin drive list` prints."""
    from twin.studies.qualify.shelf import shelf_text, shelved_drives

    drives = shelved_drives(Path.cwd())
    if as_json:
        from twin.writing import json_text

        print(json_text([shelved._asdict() for shelved in drives]))
    else:
        print(shelf_text(drives))
    return 0


def examine(as_json: bool = False, with_run: bool = False) -> int:
    """What `twin doctor` prints."""
    from twin.cli.installation.examination import examination_text, examined, verdict
    from twin.cli.installation.finding import is_ready

    findings = examined(Path.cwd(), with_run)
    if as_json:
        from twin.writing import json_text

        print(json_text({"verdict": verdict(findings), "findings": [finding._asdict() for finding in findings]}))
    else:
        print(examination_text(findings))
    return 0 if is_ready(findings) else InputRefused.exit_code


def _nothing_named() -> int:
    print_help()
    return InputRefused.exit_code


def _help() -> str:
    import typer

    from twin.cli.app import app

    command = typer.main.get_command(app)
    return command.get_help(typer.Context(command, info_name="twin"))


def _surroundings() -> list[str]:
    """What Typer makes its lines of."""
    names = ("COLUMNS", "LANGUAGE", "LC_ALL", "LC_MESSAGES", "LANG")
    said = [f"{name}={os.environ.get(name)}" for name in names]
    said += [f"{name}={value}" for name, value in os.environ.items() if name.startswith(("TYPER_", "_TYPER_"))]
    try:
        return [*said, str(os.get_terminal_size(1).columns)]
    except OSError:
        return said


ANSWERS: dict[str, Callable[[], int]] = {
    "": _nothing_named,
    "--help": print_help,
    "schema": print_schema,
    "drive list": list_drives,
    "drive list --json": lambda: list_drives(as_json=True),
    "doctor": examine,
    "doctor --json": lambda: examine(as_json=True),
}
