"""One run on the air: an event loop in a thread of its own, to which viewers are connected."""

import asyncio
import logging
import threading
import time
from collections.abc import Sequence
from concurrent.futures import Future
from contextlib import suppress
from http import HTTPStatus
from queue import SimpleQueue

from websockets.asyncio.server import ServerConnection, serve
from websockets.http11 import Request, Response

from twin.kernel.live.gate import Gate
from twin.kernel.live.protocol import SUBPROTOCOLS, Channel, Level, Message, advertisement, server_info, status
from twin.robot.live.client import Client
from twin.robot.run.tuning import Tuning

HOST = "127.0.0.1"
LARGEST = 2**16
"""Bytes of the largest message that a viewer may send; subscribing to everything takes a thousand."""
VIEWERS = 64
"""Viewers that there may be at the same time."""
COMPLAINTS = 5
"""Connections whose refusal is told in the terminal; a page that tries again and again shall not fill it."""
FAREWELL = 2.0
"""Longest time (s) to send what has been published when the run is over; after that connections are cut."""
END = 3 * FAREWELL
"""Longest time (s) that the end of a run waits for the server's thread, whatever holds it up."""

# what a viewer does wrong is told to the viewer; here it would only look like a failure of the run
_SILENT = logging.getLogger("twin.robot.live")
_SILENT.setLevel(logging.CRITICAL + 1)
# asyncio's own warning that a viewer has vanished while several of its pings were answered at once
logging.getLogger("asyncio").addFilter(lambda record: record.msg != "socket.send() raised exception.")


class Broadcast:
    """Listens as soon as it is made.

    Args:
        port: to listen at.
        gate: asked about every connection.
        channels: what can be subscribed to.
        tuning: of the run.

    Attributes:
        port: at which it listens.
        news: sentences about connections that were refused; None as soon as somebody has subscribed to something.
        wanted: channels that somebody has subscribed to.
        lacking: those of them that never change and of which somebody has nothing yet.

    Raises:
        OSError: the port is taken.
    """

    def __init__(self, port: int, gate: Gate, channels: Sequence[Channel], tuning: Tuning):
        self.news: SimpleQueue[str | None] = SimpleQueue()
        self.wanted: frozenset[int] = frozenset()
        self.lacking: frozenset[int] = frozenset()
        self.port, self._gate, self._tuning = port, gate, tuning
        self._channels = {channel.number: channel for channel in channels}
        self._greeting = (server_info(str(time.time_ns())), advertisement(channels))
        self._clients: set[Client] = set()
        self._refused: set[str] = set()
        self._begun = False
        self._over = asyncio.Event()
        self._started: Future[asyncio.AbstractEventLoop] = Future()
        self._thread = threading.Thread(target=lambda: asyncio.run(self._live()), daemon=True)
        self._thread.start()
        self._loop = self._started.result()

    def publish(self, time: int, messages: Sequence[Message]) -> None:
        """Send every viewer the simulated `time` (ns), and what it has subscribed to of `messages`."""
        self._loop.call_soon_threadsafe(self._hand_out, time, messages)

    def close(self) -> None:
        """Send what has been published, say goodbye to every viewer and let go of the port; at most `END` s."""
        # it may have ended before
        with suppress(RuntimeError):
            self._loop.call_soon_threadsafe(self._over.set)
        self._thread.join(END)

    async def _live(self) -> None:
        try:
            # no context manager: its end waits for viewers that do not read
            server = await serve(
                self._attend,
                HOST,
                self.port,
                subprotocols=SUBPROTOCOLS,
                process_request=self._admit,
                # a small message that unpacks into a large one, and work for the thread that steps
                compression=None,
                max_size=LARGEST,
                close_timeout=FAREWELL,
                logger=_SILENT,
            )
        except OSError as problem:
            self._started.set_exception(problem)
            return
        self.port = next(iter(server.sockets)).getsockname()[1]
        self._started.set_result(asyncio.get_running_loop())
        await self._over.wait()
        # who comes from now on is not let in
        server.close(close_connections=False)
        await asyncio.gather(*(client.farewell(FAREWELL) for client in self._clients))
        for client in self._clients:
            client.cut_off()
        # for connections that have not said yet what they want; whatever still waits then is cancelled with the loop
        with suppress(TimeoutError):
            await asyncio.wait_for(server.wait_closed(), FAREWELL)

    def _admit(self, connection: ServerConnection, request: Request) -> Response | None:
        """None if the connection may be made."""
        if refusal := self._gate.refusal(request.headers):
            if refusal not in self._refused and len(self._refused) < COMPLAINTS:
                self._refused.add(refusal)
                self.news.put(refusal)
            return connection.respond(HTTPStatus.FORBIDDEN, f"{refusal}\n")
        if len(self._clients) >= VIEWERS:
            return connection.respond(HTTPStatus.SERVICE_UNAVAILABLE, f"{VIEWERS} viewers are connected already\n")
        return None

    async def _attend(self, connection: ServerConnection) -> None:
        assert connection.request is not None
        knows = self._gate.knows(connection.request.path)
        client = Client(connection, knows is True, self._channels, self._tuning, self._subscribed, self._changed)
        greeting = list(self._greeting)
        if knows is False:
            greeting.append(status(Level.WARNING, "the token is not that of this run: watching only"))
        self._clients.add(client)
        try:
            await client.attend(greeting)
        finally:
            self._clients.remove(client)
            self._look_around()

    def _look_around(self) -> None:
        self.wanted = frozenset(channel for client in self._clients for channel in client.subscriptions)
        self.lacking = frozenset(channel for client in self._clients for channel in client.lacking)

    def _subscribed(self, more: bool) -> None:
        self._look_around()
        if more and not self._begun:
            self._begun = True
            self.news.put(None)

    def _changed(self, names: Sequence[str]) -> None:
        for client in self._clients:
            client.tell(names)

    def _hand_out(self, time: int, messages: Sequence[Message]) -> None:
        for client in self._clients:
            client.hand(time, messages)
        if self.lacking:
            self._look_around()
