"""The server that runs are watched through: Foxglove's WebSocket protocol on this machine's own address."""

import socket
import threading
from collections import deque
from collections.abc import Callable, Sequence
from typing import Self

import numpy as np

from twin.kernel.cosim.observers import TickEvent
from twin.kernel.errors import InputRefused
from twin.kernel.live.gate import Gate
from twin.kernel.recording.recorder import RowStream
from twin.robot.live.broadcast import HOST, Broadcast
from twin.robot.live.topics import Topics
from twin.robot.run.tuning import Tuning
from twin.robot.scene.scene import Scene

SPACING = 0.02
"""Wall time (s) from one message of a topic to the next: 50 Hz, below the 60 Hz above which Lichtblick warns."""


class LiveServer:
    """A `twin.robot.run.viewer.Viewer`; a context manager at whose exit what was published has been sent.

    Each run is a broadcast of its own at the same port, with the same token. Viewers come back by themselves, and
    before the first run the port is held by a socket that does not listen.

    Args:
        port: to listen at; 0: any that is free.
        announce: told the address, `ws://127.0.0.1:8765/?token=...`, whenever a run waits there for its first viewer.
        warn: told a sentence about connections that are refused meanwhile.
        origins: see `Gate`.

    Raises:
        InputRefused: the port is taken, or one of `origins` is none.
    """

    def __init__(
        self,
        port: int,
        announce: Callable[[str], None],
        warn: Callable[[str], None] = lambda text: None,
        origins: Sequence[str] = (),
    ):
        self._announce, self._warn, self._gate = announce, warn, Gate(origins)
        self._held = socket.socket()
        try:
            self._held.bind((HOST, port))
        except OSError as problem:
            self._held.close()
            raise _refusal(port, problem) from None
        self._port = self._held.getsockname()[1]
        self._on_air: tuple[Broadcast, Publisher | None] | None = None

    def __enter__(self) -> Self:
        return self

    def __exit__(self, *failure: object) -> None:
        self._held.close()
        self._sign_off()

    def begin(self, streams: Sequence[RowStream], scene: Scene, tick: float, tuning: Tuning) -> None:
        """Wait until somebody has subscribed to one of the topics.

        Raises:
            InputRefused: somebody has taken the port in the meantime.
        """
        self._held.close()
        self._sign_off()
        topics = Topics(streams, scene, tick)
        try:
            broadcast = Broadcast(self._port, self._gate, topics.channels, tuning)
        except OSError as problem:
            raise _refusal(self._port, problem) from None
        self._on_air = broadcast, None
        self._announce(f"ws://{HOST}:{self._port}/?token={self._gate.token}")
        for refusal in iter(broadcast.news.get, None):
            self._warn(refusal)
        self._on_air = broadcast, Publisher(topics, broadcast)

    def show(self, first: int, rows: np.ndarray, events: Sequence[TickEvent]) -> None:
        """Hand the first row of the run, the newest one and every event to the publisher."""
        if self._on_air and self._on_air[1] and len(rows):
            self._on_air[1].put(first, rows, events)

    def _sign_off(self) -> None:
        if self._on_air:
            broadcast, publisher = self._on_air
            if publisher:
                publisher.finish()
            broadcast.close()
            self._on_air = None


def _refusal(port: int, problem: Exception) -> InputRefused:
    return InputRefused(f"--port {port}: {problem}; choose another one, or 0 for any that is free")


class Publisher:
    """Publishes the rows of one run while it goes on; begins at once.

    The thread that steps only leaves its newest row here; a thread of this class takes it away from time to time,
    whatever the pace of the run. Making the messages in the thread that steps would cost that one much more, and more
    often. The first row of all is published however fast the run goes on: viewers for whom it waited see its beginning.

    Args:
        topics: of the run.
        broadcast: takes their messages.
    """

    def __init__(self, topics: Topics, broadcast: Broadcast):
        self._topics, self._broadcast = topics, broadcast
        self._happened: deque[TickEvent] = deque()
        self._first: tuple[int, np.ndarray] | None = None
        self._newest: tuple[int, np.ndarray] | None = None
        self._published = -1
        self._finished = threading.Event()
        self._thread = threading.Thread(target=self._work, daemon=True)
        self._thread.start()

    def put(self, first: int, rows: np.ndarray, events: Sequence[TickEvent]) -> None:
        """What has happened, and `rows` from tick `first` on. Of them the last one counts, until the next call."""
        if events:
            self._happened.extend(events)
        if self._first is None:
            self._first = (first, rows[0].copy())
        # one assignment, so the other thread sees either the old pair or the new one
        self._newest = (first + len(rows) - 1, rows[-1].copy())

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
        if newest is None:
            return
        if self._first is not None and self._published < 0:
            self._send(*self._first, [])
        if newest[0] > self._published:
            self._send(*newest, [self._happened.popleft() for _ in range(len(self._happened))])

    def _send(self, tick: int, row: np.ndarray, events: Sequence[TickEvent]) -> None:
        messages = self._topics.messages(tick, row, events, self._broadcast.wanted, self._broadcast.lacking)
        self._broadcast.publish(self._topics.time(tick), list(messages))
        self._published = tick
