"""Execution of one command line, with one error message and exit code."""

import sys

from twin.cli.streams import READER_GONE, NoReader, guard_terminal, share_width, standard_streams
from twin.kernel.errors import (
    InternalError,
    NotWritten,
    TwinError,
    internal_error,
    os_error_message,
    terminal_text,
)
from twin.kernel.process.job import interruption


def main() -> None:
    """Run twin's command line and end the process with its exit code."""
    with standard_streams():
        share_width()
        guard_terminal()
        code, sentence = _run_command()
        if sentence:
            print(terminal_text(sentence), file=sys.stderr)
    sys.exit(code)


def _run_command() -> tuple[int | str | None, str]:
    """Run twin's command line; return its exit code and an error message, "" after success or if already printed."""
    code: int | str | None
    try:
        try:
            # imported here, so that errors of its imports are reported too
            from twin.cli.app import run_command_line

            code, sentence = run_command_line(sys.argv[1:]), ""
        except SystemExit as end:
            code, sentence = end.code, ""
        sys.stdout.flush()
        return code, sentence
    except KeyboardInterrupt:
        # an interrupt that no command has handled
        return interruption()
    except NoReader:
        return READER_GONE, ""
    except TwinError as error:
        return error.exit_code, str(error)
    except OSError as problem:
        return NotWritten.exit_code, os_error_message(problem)
    except Exception:
        return InternalError.exit_code, str(internal_error())
