"""Progress of a study while it runs."""

from typing import Protocol


class Say(Protocol):
    """Takes what is being done, and how much of all is over, 0 .. 1; None: unknown."""

    def __call__(self, what: str, share: float | None = None, /) -> None: ...


def silent(what: str, share: float | None = None, /) -> None:
    """Where progress is not asked for."""


class Steps:
    """Counts steps that take about as long as each other.

    Args:
        say: called at the beginning of each.
        total: how many there are.
    """

    def __init__(self, say: Say, total: int):
        self._say, self._total, self._begun = say, total, 0

    def next(self, what: str) -> None:
        """The one before is over, and `what` begins."""
        self._say(f"{what}, {self._begun + 1} of {self._total}", min(1.0, self._begun / self._total))
        self._begun += 1

    def share(self, what: str, done: float) -> None:
        """So much of the present step, 0 .. 1, is over."""
        self._say(what, min(1.0, (max(0, self._begun - 1) + done) / self._total))
