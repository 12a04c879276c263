"""Typed errors. Each carries the exit code of the process that ends with it."""

import re

LONGEST_WORD = 200
"""Characters of a word that are shown whole; a value of 100 kB helps nobody who reads the sentence."""


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


class SafetyTrip(TwinError):
    """The safety monitor tripped in a run in which nothing was to go wrong."""

    exit_code = 4


class Unreachable(InputRefused, ValueError):
    """No pose or no joint angles exist for what was asked.

    Attributes:
        leg: 1, 2 or 3, the leg that cannot follow; 0 where no single leg is to blame.
        pose: what was asked, platform position (m) or joint angles (rad).
        excess: how far out it is, in m (always positive).
    """

    def __init__(self, message: str, leg: int, pose: tuple[float, ...], excess: float):
        super().__init__(message)
        self.leg = leg
        self.pose = pose
        self.excess = excess


def plain(text: str) -> str:
    """`text` fit for a terminal: control characters written out, words of more than `LONGEST_WORD` cut short."""
    return re.sub(rf"\S{{{LONGEST_WORD},}}", lambda word: f"{word[0][:60]}...{word[0][-20:]}", visible(text))


def visible(text: str) -> str:
    """`text` with control characters written out, which a terminal would obey."""
    return "".join(c if c.isprintable() or c == "\n" else repr(c)[1:-1] for c in text)
