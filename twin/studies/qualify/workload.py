"""How far a qualification is, and how long it will take, from what its ticks have taken."""

import time

from twin.kernel.errors import InputRefused
from twin.kernel.process.limits import LONG, PATIENCE, duration_text
from twin.studies.steps import Say, silent

ABOUT = 75_000
"""Ticks of a whole qualification: 60,000 of a drive that stalls at once, 100,000 of one that cannot be stalled."""
SOON = 1.0
"""s. Before, nothing is said."""


class Workload:
    """Counts ticks.

    Args:
        label: of the drive.
        say: told how far it is.
        sure: whether a check that takes more than an hour is meant.
    """

    def __init__(self, label: str, say: Say = silent, sure: bool = True):
        self._label, self._say, self._sure = label, say, sure
        self._done, self._taken = 0, 0.0
        self._told = time.monotonic()

    def take(self, ticks: int, taken: float) -> None:
        """So many more `ticks` are over; they have `taken` so long (s).

        Raises:
            InputRefused: all of them will take more than an hour, and nobody says that it is meant.
        """
        self._done += ticks
        self._taken += taken
        each = self._taken / self._done
        total = max(ABOUT, self._done)
        if self._taken > PATIENCE and each * total > LONG and not self._sure:
            raise InputRefused(
                f"{self._label}: a step takes {1e3 * each:.3g} ms, and the whole check about "
                f"{duration_text(each * total)}; say --yes if that is meant"
            )
        if self._taken > SOON and time.monotonic() - self._told > SOON:
            self._told = time.monotonic()
            self._say(f"{self._label}, {1e3 * each:.3g} ms a step", self._done / total)
