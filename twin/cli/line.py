"""One command line: answered by its words alone or by Typer, with one message and exit code.

What is answered before Typer, which takes longer to import than these answers all take, is kept
(`twin.kernel.cache_folder`), so that in the end hardly anything is imported.
"""

import os
import sys
from collections.abc import Callable
from functools import partial

from twin.cli.streams import READER_GONE, Unread, guard_terminal, show, standard_streams
from twin.kernel.cache_folder import cached_answer
from twin.kernel.errors import (
    InputRefused,
    InternalError,
    NotWritten,
    TwinError,
    internal_error,
    plain,
    system_sentence,
)
from twin.kernel.process.job import INTERRUPTED, function_called, interruption

ROOMS = ("cli", "studies")
"""Whose source the help of `twin` is made with."""


def main() -> None:
    """Entry point; ends the process with the exit code of what happened."""
    with standard_streams():
        guard_terminal()
        code, sentence = _ended()
        if sentence:
            print(plain(sentence), file=sys.stderr)
    sys.exit(code)


def _ended() -> tuple[int | str | None, str]:
    """Exit code of the command, and a sentence on what went wrong; "" if nothing did, or it has been printed."""
    try:
        try:
            code = _carried_out(sys.argv[1:])
            # Typer makes this of Ctrl-C where no command has more to say about it
            code, sentence = interruption() if code == INTERRUPTED else (code, "")
        except SystemExit as end:
            code, sentence = end.code, ""
        sys.stdout.flush()
        return code, sentence
    except Unread:
        return READER_GONE, ""
    except TwinError as error:
        return error.exit_code, str(error)
    except OSError as problem:
        return NotWritten.exit_code, system_sentence(problem)
    except Exception:
        return InternalError.exit_code, str(internal_error())


def _carried_out(words: list[str]) -> int | str | None:
    code = answered(words)
    if code is not None:
        return code
    from twin.cli.app import carried_out

    return carried_out(words)


def answered(words: list[str]) -> int | None:
    """The exit code of the command line `words`, once it is carried out; None: Typer has to read it."""
    line = " ".join(words)
    # the shell asks for what may follow; or a word has spaces, or is none
    if "_TWIN_COMPLETE" in os.environ or line.split() != words or line not in ANSWERS:
        return None
    return ANSWERS[line]()


def print_help(code: int = 0) -> int:
    """The help of `twin` itself."""
    print(cached_answer("help", _help, lambda: "\n".join(_surroundings()), rooms=ROOMS))
    return code


def _help() -> str:
    import typer

    from twin.cli.app import app

    command = typer.main.get_command(app)
    return command.get_help(typer.Context(command, info_name="twin"))


def _surroundings() -> list[str]:
    """What Typer makes its lines of."""
    names = ("COLUMNS", "LANGUAGE", "LC_ALL", "LC_MESSAGES", "LANG")
    state = [f"{name}={os.environ.get(name)}" for name in names]
    state += [f"{name}={value}" for name, value in os.environ.items() if name.startswith(("TYPER_", "_TYPER_"))]
    try:
        return [*state, str(os.get_terminal_size(1).columns)]
    except OSError:
        return state


def _ask(study: str, as_json: bool = False) -> int:
    """The exit code of a study with no options but this one."""
    answer = function_called(study)()
    show(answer, as_json)
    return int(answer.exit_code)


_SCHEMA, _DRIVES, _DOCTOR = (
    "twin.cli.starting:schema",
    "twin.studies.qualify.study:drive_list",
    "twin.cli.installation:doctor",
)
ANSWERS: dict[str, Callable[[], int]] = {
    "": partial(print_help, InputRefused.exit_code),
    "--help": print_help,
    "schema": partial(_ask, _SCHEMA),
    "drive list": partial(_ask, _DRIVES),
    "drive list --json": partial(_ask, _DRIVES, as_json=True),
    "doctor": partial(_ask, _DOCTOR),
    "doctor --json": partial(_ask, _DOCTOR, as_json=True),
}
