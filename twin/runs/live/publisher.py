"""One run on its way to the viewers.

The thread that steps only leaves its newest row here; a thread of this class takes it away from time to time, whatever
the pace of the run. Making the messages in the thread that steps would cost that one much more, and more often.
"""

import threading
from collections import deque
from collections.abc import Sequence

import numpy as np

from twin.runs.live.broadcast import Broadcast
from twin.runs.live.topics import Topics
from twin.runs.observer import Event

SPACING = 0.02
"""Wall time (s) from one message of a topic to the next: 50 Hz, below the 60 Hz above which Lichtblick warns."""


class Publisher:
    """Publishes the rows of one run while it goes on; begins at once.

    Args:
        topics: of the run. broadcast: takes their messages.
    """

    def __init__(self, topics: Topics, broadcast: Broadcast):
        self._topics, self._broadcast = topics, broadcast
        self._happened: deque[Event] = deque()
        self._newest: tuple[int, np.ndarray] | None = None
        self._published = -1
        self._finished = threading.Event()
        self._thread = threading.Thread(target=self._work, daemon=True)
        self._thread.start()

    def put(self, tick: int, row: np.ndarray, events: Sequence[Event]) -> None:
        """What has happened, and the row of `tick`, which is copied. The next row takes its place if that is sooner."""
        if events:
            self._happened.extend(events)
        # one assignment, so the other thread sees either the old pair or the new one
        self._newest = (tick, row.copy())

    def finish(self) -> None:
        """Publish the last row and stop."""
        self._finished.set()
        self._thread.join()

    def _work(self) -> None:
        while not self._finished.wait(SPACING):
            self._publish()
        self._publish()

    def _publish(self) -> None:
        newest = self._newest
        if newest is None or newest[0] == self._published:
            return
        tick, row = newest
        events = [self._happened.popleft() for _ in range(len(self._happened))]
        still = self._broadcast.newcomer.is_set()
        self._broadcast.newcomer.clear()
        messages = self._topics.messages(tick, row, events, still, self._broadcast.wanted)
        self._broadcast.publish(self._topics.time(tick), list(messages))
        self._published = tick
