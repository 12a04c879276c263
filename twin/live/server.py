"""The server that runs are watched through: Foxglove's WebSocket protocol on this machine's own address."""

import logging
import socket
import time
from collections.abc import Callable, Sequence
from types import TracebackType
from typing import Self

import foxglove
import numpy as np
from foxglove.websocket import Capability, StatusLevel

from twin.errors import InputRefused
from twin.execution.tuning import Tuning
from twin.execution.viewer import Stream
from twin.execution.watch import Event
from twin.live.listener import Listener
from twin.live.publisher import Publisher
from twin.scene.scene import Scene

# what a client does wrong is told to the client; here it would only look like a failure of the run
logging.getLogger("foxglove").setLevel(logging.CRITICAL)

HOST = "127.0.0.1"
FAREWELL = 0.2
"""Time (s) to send what has been published: the SDK cannot be asked when it is done, and drops the rest at the end."""
PATIENCE = 5.0
"""Time (s) in which a port has to become free again."""


class LiveServer:
    """A `twin.execution.viewer.Viewer`; a context manager at whose exit what was published has been sent.

    Each run has a server of its own, which listens as soon as all topics of the run are there: whoever subscribes in
    the moment in which the SDK announces a topic may hear that it is unknown. Viewers come back by themselves, and
    before the first run the port is held by a socket that does not listen.

    Args:
        port: to listen at; 0: any that is free.
        announce: told the address, `ws://127.0.0.1:8765`, whenever a run waits there for its first viewer.

    Raises:
        InputRefused: the port is taken.
    """

    def __init__(self, port: int, announce: Callable[[str], None]):
        self._announce = announce
        self._held = socket.socket()
        try:
            self._held.bind((HOST, port))
        except OSError as problem:
            self._held.close()
            raise _refusal(port, problem) from None
        self._port = self._held.getsockname()[1]
        self._on_air: tuple[foxglove.WebSocketServer, Publisher, Listener] | None = None

    def __enter__(self) -> Self:
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        self._held.close()
        self._sign_off()

    def begin(self, streams: Sequence[Stream], scene: Scene, tick: float, tuning: Tuning) -> None:
        """Wait until somebody has subscribed to one of the topics.

        Raises:
            InputRefused: somebody has taken the port in the meantime.
        """
        self._held.close()
        self._sign_off()
        context = foxglove.Context()
        publisher = Publisher(context, streams, scene, tick)
        listener = Listener(tuning)
        server = self._listening(listener, context)
        listener.refuse = lambda text: server.publish_status(text, StatusLevel.Warning)
        self._on_air = server, publisher, listener
        self._announce(f"ws://{HOST}:{self._port}")
        listener.watched.wait()
        publisher.start(server, listener.newcomer)

    def show(self, first: int, rows: np.ndarray, events: Sequence[Event]) -> None:
        """Hand the newest row and every event to the publisher."""
        if self._on_air and len(rows):
            self._on_air[1].put(first + len(rows) - 1, rows[-1], events)

    def _listening(self, listener: Listener, context: foxglove.Context) -> foxglove.WebSocketServer:
        """A server at our port, as soon as the one of the run before has let go of it."""
        deadline = time.monotonic() + PATIENCE
        while True:
            try:
                return foxglove.start_server(
                    name="twin",
                    host=HOST,
                    port=self._port,
                    capabilities=[Capability.Time, Capability.Parameters],
                    server_listener=listener,
                    context=context,
                )
            except RuntimeError as problem:
                if time.monotonic() > deadline:
                    raise _refusal(self._port, problem) from None
                time.sleep(0.05)

    def _sign_off(self) -> None:
        if self._on_air:
            server, publisher, listener = self._on_air
            publisher.finish()
            time.sleep(FAREWELL)
            # a server that is being stopped cannot be asked for anything
            listener.refuse = lambda text: None
            server.stop()
            self._on_air = None


def _refusal(port: int, problem: Exception) -> InputRefused:
    return InputRefused(f"--port {port}: {problem}; choose another one, or 0 for any that is free")
