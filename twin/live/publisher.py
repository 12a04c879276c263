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
from twin.live.channels import EventChannel, SceneChannels, nanoseconds, stream_channels
from twin.live.encoding import Encoder
from twin.scene.scene import Scene

SPACING = 0.02
"""Wall time (s) from one message of a topic to the next: 50 Hz, below the 60 Hz above which Lichtblick warns."""


class Publisher:
    """Publishes the rows of one run while it goes on.

    Args:
        server, context: what its channels belong to.
        streams, scene, tick: see `twin.execution.viewer.Viewer.begin`.
        newcomer: set when somebody has subscribed to something, cleared when what never changes has been sent again.
    """

    def __init__(
        self,
        server: foxglove.WebSocketServer,
        context: foxglove.Context,
        streams: Sequence[Stream],
        scene: Scene,
        tick: float,
        newcomer: threading.Event,
    ):
        self._server, self._tick, self._newcomer = server, tick, newcomer
        self._encoder = Encoder(streams)
        self._streams = stream_channels(context, [stream.topic for stream in streams])
        self._scene = SceneChannels(context, scene)
        self._events = EventChannel(context)
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
        for channel in (*self._streams, *self._scene, self._events.channel):
            channel.close()

    def _work(self) -> None:
        while not self._finished.wait(SPACING):
            self._publish()
        self._publish()

    def _publish(self) -> None:
        newest = self._newest
        if newest is None or newest[0] == self._published:
            return
        tick, row = newest
        time = nanoseconds(tick, self._tick)
        # first, because viewers stamp what they receive with it
        self._server.broadcast_time(time)
        while self._happened:
            event = self._happened.popleft()
            self._events.publish(nanoseconds(event.tick, self._tick), event)
        # sampled outputs stay valid until the next sample, so all of the row is what is valid now
        for channel, message in zip(self._streams, self._encoder.messages(row), strict=True):
            channel.log(message, log_time=time)
        still = self._newcomer.is_set()
        self._newcomer.clear()
        self._scene.publish(time, row, still)
        self._published = tick
