"""Standard output on a terminal: what names of files, columns and drives say is shown, and never obeyed."""

import re
import sys
from typing import Any, TextIO

_OBEYED = re.compile(r"\x1b(?!\[[0-9;]*m)|[\x00-\x08\x0b\x0c\x0e-\x1a\x1c-\x1f\x7f-\x9f]")
"""Control characters, but line ends, tabs and the colours of the help."""


class Harmless:
    """A stream that writes control characters out: `\\x07` instead of a bell.

    Args:
        stream: the terminal; everything but writing is left to it.
    """

    def __init__(self, stream: TextIO):
        self._stream = stream

    def write(self, text: str) -> int:
        """Write `text`."""
        return self._stream.write(_OBEYED.sub(lambda found: repr(found[0])[1:-1], text))

    def __getattr__(self, name: str) -> Any:
        return getattr(self._stream, name)


def guard_terminal() -> None:
    """From now on standard output is `Harmless`, if it is a terminal; files and pipes get what was written."""
    if sys.stdout.isatty():
        sys.stdout = Harmless(sys.stdout)  # type: ignore[assignment]
