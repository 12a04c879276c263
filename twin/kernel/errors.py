"""Typed errors, each with an exit code of the process, and the formatting of error messages."""

import re
from collections.abc import Iterable, Iterator, Sequence
from contextlib import contextmanager

MAX_WORD_LENGTH = 200
"""Maximum length of a word shown in full (characters); 100 kB values make a message unreadable."""
MAX_MESSAGE_LINES = 60
"""Maximum number of lines of an error message; more would scroll the first error out of sight."""
PATH_ERRORS = (OSError, ValueError)


class TwinError(Exception):
    """Base of all errors that twin raises deliberately; its text is one clear sentence for the user."""

    exit_code = 1


class InputRefused(TwinError):
    """Error that refuses a configuration, FMU or file before the run: place, value, expected value, remedy."""

    exit_code = 2


class NotWritten(TwinError):
    """Error that a file cannot be written: read-only folder, full disk. The previous file is unchanged."""

    exit_code = 3


class ComponentFailed(TwinError):
    """Error that a component failed during the co-simulation."""

    exit_code = 3


class EndRequest(ComponentFailed):
    """Request of a component to end the simulation; a caller may treat it as a regular end."""


class SafetyTrip(TwinError):
    """Error that the safety monitor tripped in a run without intended faults."""

    exit_code = 4


class InternalError(TwinError):
    """Error for an unexpected exception of this process or of a worker: a defect of twin."""

    exit_code = 70


def internal_error() -> InternalError:
    """Convert the exception that is being handled to an `InternalError` with its traceback."""
    # imported here: most commands never need it
    import traceback

    return InternalError(f"{traceback.format_exc()}internal error of twin; please report it with the lines above")


def os_error_message(problem: OSError) -> str:
    """Return the message of an unexpected OSError; a traceback would point at twin's code, which is not the cause."""
    return f"{problem.filename or 'twin'}: refused by the operating system: {problem.strerror or problem}"


@contextmanager
def translate_disk_errors(
    place: object,
    trouble: str = "cannot be written",
    kind: type[TwinError] = NotWritten,
    remedy: str = "",
    caught: type[Exception] | tuple[type[Exception], ...] = OSError,
) -> Iterator[None]:
    """Raise errors of the disk in the block as `kind`, with one message: `a.csv: cannot be written: No space left`.

    `caught` has to be `PATH_ERRORS` if a path may contain a NUL.
    """
    try:
        yield
    except caught as problem:
        why = getattr(problem, "strerror", None) or problem
        raise kind(f"{place}: {trouble}: {why}" + (f"; {remedy}" if remedy else "")) from None


def nearest(got: str, known: Iterable[str], otherwise: str = "known are {}", most: int = 1) -> str:
    """Return a hint from a misspelt name `got` to the most similar known name: `did you mean 'kp_per_s'?`

    A known name that contains it as whole words comes first, as a missing unit is the most common error. `otherwise` is
    the hint without a similar name, {} in it for all known names.
    """
    names = list(known)
    close = close_matches(got, names, most)
    if not close:
        return otherwise.replace("{}", ", ".join(names) or "none")
    return "did you mean " + " or ".join(f"'{name}'" for name in close) + "?"


def close_matches(got: str, names: Sequence[str], most: int = 1) -> list[str]:
    """Return at most `most` of `names` that are similar to `got`, see `nearest`."""
    # imported here: most commands have no error
    import difflib

    words = re.compile(rf"(?<![^\W_]){re.escape(got)}(?![^\W_])")
    close = [name for name in names if got and words.search(name)][:most]
    return close or difflib.get_close_matches(got, names, most, cutoff=0.5)


def escape_controls(text: str) -> str:
    """Return `text` on one line, with control characters escaped."""
    return "".join(c if c.isprintable() else repr(c)[1:-1] for c in text)


def escape_control_lines(text: str) -> str:
    """Return `text` with control characters other than line feeds escaped."""
    return "\n".join(escape_controls(line) for line in text.split("\n"))


def terminal_text(text: str) -> str:
    """Make `text` safe for a terminal: escape control characters, shorten words of more than `MAX_WORD_LENGTH`
    characters, and drop lines after `MAX_MESSAGE_LINES`.
    """
    lines = escape_control_lines(text).split("\n")
    if len(lines) > MAX_MESSAGE_LINES:
        lines[MAX_MESSAGE_LINES:] = [f"... and {len(lines) - MAX_MESSAGE_LINES} more lines"]
    return re.sub(rf"\S{{{MAX_WORD_LENGTH},}}", lambda word: f"{word[0][:60]}...{word[0][-20:]}", "\n".join(lines))


class RecordingWriteError(NotWritten):
    """Error that a recording cannot be written: disk full, no permission; the data written so far stays readable."""


class RecordingError(InputRefused):
    """Error that a recording cannot be read: missing, empty, not MCAP, or of another layout."""


class RecordingDamageError(RecordingError):
    """Error that bytes of a recording have changed since it was written; `salvage=True` reads the data before."""


class UnknownSeries(RecordingError, KeyError):
    """Error that a recording lacks a topic or field."""

    def __init__(self, sentence: str, key: str):
        super().__init__(sentence, key)
        self.key = key

    def __str__(self) -> str:
        # KeyError would print the repr of the message
        return str(self.args[0])
