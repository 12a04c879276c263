"""Typed errors. Each carries the exit code of the process that ends with it."""

import re
from collections.abc import Iterable, Iterator, Sequence
from contextlib import contextmanager

MAX_WORD_LENGTH = 200
"""Characters of a word that are shown whole; a value of 100 kB helps no reader of the sentence."""

MAX_MESSAGE_LINES = 60
"""Of a sentence with many mistakes: more would push the first out of sight."""

PATH_ERRORS = (OSError, ValueError)


class TwinError(Exception):
    """Base of every error this product raises on purpose; its text is one clear sentence for the user."""

    exit_code = 1


class InputRefused(TwinError):
    """A configuration, FMU or file was refused before anything ran: where, got, expected, remedy."""

    exit_code = 2


class NotWritten(TwinError):
    """A file could not be written: read-only folder, full disk. What was there before is still there."""

    exit_code = 3


class ComponentFailed(TwinError):
    """A component failed while the co-simulation was running."""

    exit_code = 3


class EndRequest(ComponentFailed):
    """A component asked for the end of the simulation: regular, where the caller takes it as that."""


class SafetyTrip(TwinError):
    """The safety monitor tripped in a run in which nothing was to go wrong."""

    exit_code = 4


class InternalError(TwinError):
    """An exception that no code foresaw, of this process or of a worker: a defect of twin."""

    exit_code = 70


def internal_error() -> InternalError:
    """Return the error for the exception that is being handled, with its traceback."""
    # most commands never need it
    import traceback

    return InternalError(f"{traceback.format_exc()}internal error of twin; please report it with the lines above")


def os_error_message(problem: OSError) -> str:
    """An unforeseen failure of the surroundings; a traceback would show our code, which is not to blame."""
    return f"{problem.filename or 'twin'}: {problem.strerror or problem}"


@contextmanager
def translate_disk_errors(
    place: object,
    trouble: str = "cannot be written",
    kind: type[TwinError] = NotWritten,
    remedy: str = "",
    caught: type[Exception] | tuple[type[Exception], ...] = OSError,
) -> Iterator[None]:
    """What the disk refuses in the block, as a sentence: `a.csv: cannot be written: No space left on device`.

    Args:
        place: file or folder.
        trouble: what cannot be done with it.
        kind: of error.
        remedy: what to do about it.
        caught: `PATH_ERRORS` where a name may have a NUL in it.
    """
    try:
        yield
    except caught as problem:
        why = getattr(problem, "strerror", None) or problem
        raise kind(f"{place}: {trouble}: {why}" + (f"; {remedy}" if remedy else "")) from None


def nearest(got: str, known: Iterable[str], otherwise: str = "known are {}", most: int = 1) -> str:
    """Half a sentence that leads from a misspelt name to what was meant: `did you mean 'kp_per_s'?`

    Args:
        got: what was written. A name of which it is whole words is meant before one that is merely like it: a key
            without its unit is the commonest slip.
        known: the names there are.
        otherwise: what is said if none of them is like it, with {} where all of them are to stand.
        most: so many are offered.
    """
    names = list(known)
    close = close_matches(got, names, most)
    if not close:
        return otherwise.replace("{}", ", ".join(names) or "none")
    return "did you mean " + " or ".join(f"'{name}'" for name in close) + "?"


def close_matches(got: str, names: Sequence[str], most: int = 1) -> list[str]:
    """Those of `names` that may have been meant by `got`, at most so many, as `nearest` tells them."""
    # most commands have no mistake
    import difflib

    words = re.compile(rf"(?<![^\W_]){re.escape(got)}(?![^\W_])")
    close = [name for name in names if got and words.search(name)][:most]
    return close or difflib.get_close_matches(got, names, most, cutoff=0.5)


def escape_controls(text: str) -> str:
    """`text` on one line, control characters written out."""
    return "".join(c if c.isprintable() else repr(c)[1:-1] for c in text)


def escape_control_lines(text: str) -> str:
    """`text` on the lines it has, other control characters written out."""
    return "\n".join(escape_controls(line) for line in text.split("\n"))


def terminal_text(text: str) -> str:
    """`text` fit for a terminal: control characters written out, words of more than `MAX_WORD_LENGTH` and all lines after
    `MAX_MESSAGE_LINES` cut short."""
    lines = escape_control_lines(text).split("\n")
    if len(lines) > MAX_MESSAGE_LINES:
        lines[MAX_MESSAGE_LINES:] = [f"... and {len(lines) - MAX_MESSAGE_LINES} more lines"]
    return re.sub(rf"\S{{{MAX_WORD_LENGTH},}}", lambda word: f"{word[0][:60]}...{word[0][-20:]}", "\n".join(lines))


class RecordingWriteError(NotWritten):
    """A recording could not be written: disk full, no permission; what was written stays readable."""


class RecordingError(InputRefused):
    """A file is not a recording that can be read: missing, empty, not MCAP, or of another layout."""


class RecordingDamageError(RecordingError):
    """A recording's bytes are not those that were written; `salvage=True` reads what precedes the damage."""


class UnknownSeries(RecordingError, KeyError):
    """A recording was asked for a topic or field it does not hold.

    Args:
        sentence: for the user.
        key: what was asked for.
    """

    def __init__(self, sentence: str, key: str):
        super().__init__(sentence, key)
        self.key = key

    def __str__(self) -> str:
        # KeyError prints the repr of its argument, with quotes and escapes; the user gets the sentence
        return str(self.args[0])
