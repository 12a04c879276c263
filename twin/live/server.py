"""The server that runs are watched through: Foxglove's WebSocket protocol on this machine's own address.

The SDK's threads do the sending; the thread that steps only hands them bytes.
"""

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
from twin.live.channels import EventChannel, StreamChannel, channels, nanoseconds
from twin.live.listener import Listener

HOST = "127.0.0.1"
SPACING = 0.018
"""Least wall time (s) from one message of a topic to the next. Lichtblick warns of topics above 60 Hz; a bit less than
two slices of a paced run, so that a deadline met late makes none wait for the third."""


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
        self._streams: list[StreamChannel] = []
        self._events: EventChannel | None = None
        self._tick, self._last_tick, self._due = 0.0, 0, 0.0

    def __enter__(self) -> Self:
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        self._server.stop()

    def begin(self, streams: Sequence[Stream], tick: float, last_tick: int, tuning: Tuning) -> None:
        """Announce the topics; the first run waits here until somebody has subscribed to one."""
        for channel in self._streams:
            channel.close()
        if self._events:
            self._events.close()
            # time begins again at 0
            self._server.clear_session()
        self._listener.tuning = tuning
        self._tick, self._last_tick, self._due = tick, last_tick, 0.0
        self._streams = channels(self._context, streams, tick)
        self._events = EventChannel(self._context, tick)
        self._listener.watched.wait()

    def show(self, first: int, rows: np.ndarray, events: Sequence[Event]) -> None:
        """Publish the newest rows, unless viewers have had some just now, and every event."""
        assert self._events is not None
        self._events.publish(events)
        now, last = time.monotonic(), first + len(rows) - 1
        if len(rows) == 0 or (now < self._due and last < self._last_tick):
            return
        self._due = now + SPACING
        # first, because viewers stamp what they receive with it
        self._server.broadcast_time(nanoseconds(last, self._tick))
        for channel in self._streams:
            channel.publish(first, rows)

    def _warn(self, text: str) -> None:
        self._server.publish_status(text, StatusLevel.Warning)
