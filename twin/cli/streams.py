"""Standard streams of a command, which may be closed, full, without a reader, or a terminal."""

import contextlib
import os
import re
import shlex
import shutil
import sys
from collections.abc import Iterator
from typing import TYPE_CHECKING, Any, TextIO

from twin.kernel.atomic_write import json_text
from twin.kernel.errors import NotWritten, escape_control_lines

if TYPE_CHECKING:
    from twin.studies.command import Answer

READER_GONE = 128 + 13
"""Exit code of a command whose output lost its reader: the shell's code for SIGPIPE."""
_CONTROL_CHARACTERS = re.compile(r"\x1b(?!\[[0-9;]*m)|[\x00-\x08\x0b\x0c\x0e-\x1a\x1c-\x1f\x7f-\x9f]")
"""Control characters except line ends, tabs and the colours of the help."""
_NEXT_COMMAND = re.compile(r"^(\s*(?:next|then):? +)twin(?= )", re.MULTILINE)
"""Program name in the line that suggests the next command."""


class NoReader(Exception):
    """Exception that standard output has lost its reader, such as `head`."""


class _Stream:
    """Base of wrappers of a text stream that forward everything except writing."""

    def __init__(self, stream: TextIO):
        self._stream = stream

    def __getattr__(self, name: str) -> Any:
        return getattr(self._stream, name)


class Outlet(_Stream):
    """Wrapper of standard output that raises clear errors when writing fails."""

    def write(self, text: str) -> int:
        """Write text to standard output; return the number of characters.

        NoReader: the reader has gone. NotWritten: the stream cannot be written.
        """
        with _writing_output():
            return self._stream.write(text)

    def flush(self) -> None:
        with _writing_output():
            self._stream.flush()


class BestEffortStderr(_Stream):
    """Wrapper of standard error that ignores failed writes."""

    def write(self, text: str) -> int:
        with contextlib.suppress(OSError):
            self._stream.write(text)
        return len(text)

    def flush(self) -> None:
        with contextlib.suppress(OSError):
            self._stream.flush()


@contextlib.contextmanager
def standard_streams() -> Iterator[None]:
    """Open all standard streams in the block; closed ones become null, so that no other file gets their descriptors."""
    for number in (0, 1, 2):
        try:
            os.fstat(number)
        except OSError:
            # open returns the lowest free descriptor, i.e. this one
            os.open(os.devnull, os.O_RDWR)
    before = sys.stdin, sys.stdout, sys.stderr
    output, errors = sys.stdout or _open_output(1), sys.stderr or _open_output(2)
    sys.stdin = sys.stdin or os.fdopen(0, encoding="utf-8", closefd=False)
    sys.stdout, sys.stderr = Outlet(output), BestEffortStderr(errors)  # type: ignore[assignment]
    try:
        yield
    finally:
        for number, stream in ((1, output), (2, errors)):
            try:
                stream.flush()
            except OSError:
                _redirect_to_null(number)
        sys.stdin, sys.stdout, sys.stderr = before


@contextlib.contextmanager
def _writing_output() -> Iterator[None]:
    try:
        yield
    except BrokenPipeError:
        raise NoReader from None
    except OSError as problem:
        raise NotWritten(f"standard output: cannot be written: {problem.strerror}") from None


def _redirect_to_null(number: int) -> None:
    """Redirect a broken output stream to null: at exit Python would try to flush it once more, and fail again."""
    nothing = os.open(os.devnull, os.O_WRONLY)
    os.dup2(nothing, number)
    os.close(nothing)


def _open_output(number: int) -> TextIO:
    return os.fdopen(number, "w", encoding="utf-8", closefd=False)


class EscapingTerminal(_Stream):
    """Wrapper of a terminal's output that escapes control characters: `\x07` instead of a bell."""

    def write(self, text: str) -> int:
        return self._stream.write(_CONTROL_CHARACTERS.sub(lambda found: repr(found[0])[1:-1], text))


def share_width() -> None:
    """Set the width of text to the width of the terminal, for this process and its worker processes."""
    from twin.studies.result import WIDTH_VARIABLE

    if sys.stdout.isatty():
        os.environ[WIDTH_VARIABLE] = str(shutil.get_terminal_size().columns)
    else:
        os.environ.pop(WIDTH_VARIABLE, None)


def guard_terminal() -> None:
    """Escape control characters in standard output if it is a terminal; files and pipes get the unchanged text."""
    if sys.stdout.isatty():
        sys.stdout = EscapingTerminal(sys.stdout)  # type: ignore[assignment]


def print_answer(answer: "Answer", as_json: bool = False) -> None:
    """Print the answer of a command; suggested next commands begin with the program's name for the shell."""
    from twin.cli.terminal import program

    text = _NEXT_COMMAND.sub(lambda found: found[1] + shlex.quote(program()), answer.text)
    # names in a recording are untrusted
    print(json_text(answer.facts) if as_json else escape_control_lines(text), flush=True)
