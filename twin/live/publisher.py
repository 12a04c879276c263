"""One run on its way to the viewers.

The thread that steps only leaves its newest row here; a thread of this class takes it away from time to time, whatever
the pace of the run. Handing each message to the server from the thread that steps would cost that one a hundred times
as much: every message wakes a thread of the server, and the processor is often given to that at once.
"""

import threading
from collections import deque
from collections.abc import Sequence

import foxglove
import numpy as np

from twin.execution.viewer import Stream
from twin.execution.watch import Event
from twin.live.channels import EventChannel, channels, nanoseconds
from twin.live.encoding import Encoder

SPACING = 0.02
"""Wall time (s) from one message of a topic to the next: 50 Hz, below the 60 Hz above which Lichtblick warns."""


class Publisher:
    """Publishes the rows of one run while it goes on.

    Args:
        server, context: what its channels belong to. streams: topics in the order of the recording. tick: duration (s).
    """

    def __init__(
        self, server: foxglove.WebSocketServer, context: foxglove.Context, streams: Sequence[Stream], tick: float
    ):
        self._server, self._tick = server, tick
        self._encoder = Encoder(streams)
        self._streams = channels(context, [stream.topic for stream in streams], tick)
        self._events = EventChannel(context, tick)
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
        """Publish the last row and stop; the topics stay announced."""
        self._finished.set()
        self._thread.join()

    def withdraw(self) -> None:
        """Take the topics off the list."""
        for channel in self._streams:
            channel.close()
        self._events.close()

    def _work(self) -> None:
        while not self._finished.wait(SPACING):
            self._publish()
        self._publish()

    def _publish(self) -> None:
        newest = self._newest
        if newest is None or newest[0] == self._published:
            return
        tick, row = newest
        # first, because viewers stamp what they receive with it
        self._server.broadcast_time(nanoseconds(tick, self._tick))
        while self._happened:
            self._events.publish(self._happened.popleft())
        for channel, message in zip(self._streams, self._encoder.messages(row), strict=True):
            channel.publish(self._published + 1, tick, message)
        self._published = tick
