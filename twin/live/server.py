"""The server that runs are watched through: Foxglove's WebSocket protocol on this machine's own address."""

import time
from collections.abc import Sequence
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

HOST = "127.0.0.1"
FAREWELL = 0.2
"""Time (s) to send what has been published: the SDK cannot be asked when it is done, and drops the rest at the end."""


class LiveServer:
    """A `twin.execution.viewer.Viewer`; a context manager at whose exit what was published has been sent.

    Args:
        port: to listen at; 0: any that is free.

    Attributes:
        address: for a viewer, `ws://127.0.0.1:8765`.

    Raises:
        InputRefused: the port is taken.
    """

    def __init__(self, port: int):
        self._context = foxglove.Context()
        self._listener = Listener(self._warn)
        try:
            self._server = foxglove.start_server(
                name="twin",
                host=HOST,
                port=port,
                capabilities=[Capability.Time, Capability.Parameters],
                server_listener=self._listener,
                context=self._context,
            )
        except RuntimeError as problem:
            raise InputRefused(f"--port {port}: {problem}; choose another one, or 0 for any that is free") from None
        self.address = f"ws://{HOST}:{self._server.port}"
        self._publisher: Publisher | None = None

    def __enter__(self) -> Self:
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        if self._publisher:
            self._publisher.finish()
            time.sleep(FAREWELL)
        self._server.stop()

    def begin(self, streams: Sequence[Stream], scene: Scene, tick: float, tuning: Tuning) -> None:
        """Announce the topics; the first run waits here until somebody has subscribed to one."""
        if self._publisher:
            self._publisher.finish()
            self._publisher.withdraw()
            # time begins again at 0
            self._server.clear_session()
        self._listener.tuning = tuning
        self._publisher = Publisher(self._server, self._context, streams, scene, tick, self._listener.newcomer)
        self._listener.watched.wait()

    def show(self, first: int, rows: np.ndarray, events: Sequence[Event]) -> None:
        """Hand the newest row and every event to the publisher."""
        if self._publisher and len(rows):
            self._publisher.put(first + len(rows) - 1, rows[-1], events)

    def _warn(self, text: str) -> None:
        self._server.publish_status(text, StatusLevel.Warning)
