"""How a command begins and ends: its streams, and how every error becomes one message and an exit code."""

import sys

from twin.cli.early import answered
from twin.cli.streams import READER_GONE, Unread, standard_streams
from twin.cli.terminal import guard_terminal
from twin.errors import NotWritten, TwinError, plain, system_sentence
from twin.runs.guard.interrupt import INTERRUPTED


def main() -> None:
    """Entry point; ends the process with the exit code of what happened."""
    with standard_streams():
        guard_terminal()
        code, told = _ended()
        if told:
            print(plain(told), file=sys.stderr)
    sys.exit(code)


def _ended() -> tuple[int | str | None, str]:
    """Exit code of the command, and a sentence on what went wrong; "" if nothing did, or it has been told."""
    try:
        try:
            code = _carried_out(sys.argv[1:])
            # Typer makes this of Ctrl-C where no command has more to say about it
            told = "interrupted" if code == INTERRUPTED else ""
        except SystemExit as end:
            code, told = end.code, ""
        sys.stdout.flush()
        return code, told
    except Unread:
        return READER_GONE, ""
    except TwinError as error:
        return error.exit_code, str(error)
    except OSError as problem:
        return NotWritten.exit_code, system_sentence(problem)


def _carried_out(words: list[str]) -> int | str | None:
    code = answered(words)
    if code is not None:
        return code
    from twin.cli.app import carried_out

    return carried_out(words)
