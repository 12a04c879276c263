"""What is compiled while a run is made ready, told as it goes."""

import threading
import time

from twin.cli.progress import Progress
from twin.compiled.store import compiled_pieces

PIECES = 18
"""How many pieces of machine code a run of Fig. 4 needs, about; where none is there yet."""
PERIOD = 0.25
"""Seconds between two looks at what has been compiled."""


class CompileWatch:
    """Looks at the kept compiled code from time to time and tells `progress` when there is more, from `start` to `end`.

    What other commands compile at the same time is counted too: it will not have to be compiled here.
    """

    def __init__(self, progress: Progress):
        self._progress = progress
        self._before = compiled_pieces()
        self._over = threading.Event()
        self._thread = threading.Thread(target=self._look, daemon=True)

    def start(self) -> None:
        """Look from now on."""
        self._thread.start()

    def end(self) -> None:
        """Look no more; the line belongs to others from now on. To be called as often as one likes."""
        self._over.set()
        if self._thread.is_alive():
            self._thread.join()

    def _look(self) -> None:
        began = time.monotonic()
        while not self._over.wait(PERIOD):
            new = compiled_pieces() - self._before
            if new:
                # how many are lacking of those that were there in part, or of a run that needs more, nobody knows
                about = PIECES if not self._before and new < PIECES else 0
                self._progress.compile(new, about, time.monotonic() - began)
