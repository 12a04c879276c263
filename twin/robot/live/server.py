"""Live server: Foxglove's WebSocket protocol on the loopback address.

Viewers connect to an event loop in a separate thread, one per run.
"""

import asyncio
import logging
import os
import socket
import threading
import time
from collections import deque
from collections.abc import Callable, Collection, Mapping, Sequence
from concurrent.futures import Future
from contextlib import suppress
from http import HTTPStatus
from queue import SimpleQueue
from typing import Protocol, Self

import numpy as np
from websockets.asyncio.server import ServerConnection, serve
from websockets.exceptions import ConnectionClosed
from websockets.http11 import Request, Response

from twin.kernel import live
from twin.kernel.cosim.observers import TickEvent
from twin.kernel.errors import InputRefused
from twin.kernel.gate import LOOPBACK_HOST, Gate, viewer_policy
from twin.kernel.recording.recorder import RowStream
from twin.robot.live.topics import SceneSource, Topics

MAX_BACKLOG = 1024
"""Maximum number of messages queued for a slow viewer; then the oldest are dropped."""
MESSAGE_INTERVAL = 0.02
"""Wall time (s) between messages of a topic: 50 Hz, as Lichtblick warns above 60 Hz."""
READ_ONLY_REFUSAL = "refused: this viewer watches only; to tune, open the address that twin has printed, with its token"
MAX_MESSAGE_BYTES = 2**16
"""Maximum size (bytes) of a viewer's message; subscribing to everything takes a thousand."""
MAX_VIEWERS = 64
MAX_REFUSALS = 5
"""Maximum number of printed refusals, so that a page that keeps reconnecting does not flood the terminal."""
CLOSE_TIMEOUT = 2.0
"""Timeout (s) for sending queued messages at the end of a run; then connections are cut."""
SHUTDOWN_TIMEOUT = 3 * CLOSE_TIMEOUT
"""Timeout (s) for the server's thread to end after a run."""
# viewers are informed of their errors; logged here, they would look like failures of the run
_SILENT_LOGGER = logging.getLogger("twin.robot.live")


class Parameters(Protocol):
    """Interface of the parameters that a live viewer may change; called by the server's thread."""

    def values(self) -> Mapping[str, bool | float | str]:
        """Return all parameters that a viewer may see or change, by name."""

    def request(self, name: str, value: object, /) -> None:
        """Request a new value of a parameter of the run for a live viewer; InputRefused if it is invalid or unknown."""


class Client:
    """One live viewer's connection, within the server's event loop.

    Args:
        may_tune: whether it may change parameters.
        subscribed: called with True when it has subscribed, False when it has unsubscribed.
        changed: called with the names of the parameters that it requested to change.

    Attributes:
        subscriptions: the viewer's subscription id, by channel.
        lacking: subscribed constant channels whose message has not been sent yet.
    """

    def __init__(
        self,
        connection: ServerConnection,
        may_tune: bool,
        channels: Mapping[int, live.Channel],
        tuning: Parameters,
        subscribed: Callable[[bool], None],
        changed: Callable[[Sequence[str]], None],
    ):
        self.subscriptions: dict[int, int] = {}
        self.lacking: set[int] = set()
        self._connection, self._may_tune, self._channels = connection, may_tune, channels
        self._tuning, self._on_subscription, self._on_change = tuning, subscribed, changed
        self._follows: set[str] = set()
        # messages of constant channels are sent once, so they must not be dropped with a full queue
        self._once: dict[int, bytes] = {}
        self._waiting: deque[str | bytes | None] = deque(maxlen=MAX_BACKLOG)
        self._ready = asyncio.Event()
        self._sending = asyncio.create_task(self._send())

    async def serve(self, greeting: Sequence[str]) -> None:
        """Send the viewer a greeting, then answer its requests until it disconnects."""
        try:
            for message in greeting:
                await self._connection.send(message)
            # each answer is awaited, so serving stops for a viewer that stops reading
            async for frame in self._connection:
                for answer in self._answers(frame):
                    await self._connection.send(answer)
        except ConnectionClosed:
            pass
        finally:
            self._sending.cancel()

    def send_messages(self, time: int, messages: Sequence[live.Message]) -> None:
        """Queue the simulated `time` (ns) and the messages of subscribed channels for the viewer."""
        found, sent = self.subscriptions, [live.time_message(time)]
        for message in messages:
            if message.channel in self.lacking:
                self.lacking.remove(message.channel)
                self._once[message.channel] = live.message_data(found[message.channel], message)
            elif message.channel in found and not self._channels[message.channel].constant:
                sent.append(live.message_data(found[message.channel], message))
        self._enqueue(*sent)

    def send_parameters(self, names: Sequence[str]) -> None:
        """Queue the values of changed parameters that the viewer follows."""
        if wanted := self._follows.intersection(names):
            self._enqueue(live.parameter_values(self._values(wanted)))

    async def drain_and_close(self, patience: float) -> None:
        """Send queued messages and close the viewer's connection; give up after `patience` (s)."""
        self._enqueue(None)
        await asyncio.wait([self._sending], timeout=patience)

    def cut_off(self) -> None:
        """Abort the viewer's connection and drop unsent messages; all pending sends end."""
        self._connection.transport.abort()

    def _enqueue(self, *messages: str | bytes | None) -> None:
        self._waiting.extend(messages)
        self._ready.set()

    async def _send(self) -> None:
        try:
            while True:
                await self._ready.wait()
                self._ready.clear()
                while self._once or self._waiting:
                    message = self._once.popitem()[1] if self._once else self._waiting.popleft()
                    if message is None:
                        await self._connection.close(1001)
                        return
                    await self._connection.send(message)
        except ConnectionClosed:
            pass

    def _answers(self, frame: str | bytes) -> list[str]:
        if isinstance(frame, bytes):
            return [live.status(live.Level.ERROR, "not understood: nothing binary is expected here")]
        try:
            return self._answer(live.parse_request(frame))
        except InputRefused as refusal:
            return [live.status(live.Level.ERROR, str(refusal))]

    def _answer(self, asked: live.Request) -> list[str]:
        match asked:
            case live.Subscribe():
                return self._subscribe(asked)
            case live.Unsubscribe():
                left = {c: number for c, number in self.subscriptions.items() if number not in asked.ids}
                self.subscriptions = left
                self.lacking &= left.keys()
                self._on_subscription(False)
            case live.GetParameters():
                return [live.parameter_values(self._values(asked.names), asked.id)]
            case live.SetParameters():
                return self._set_parameters(asked)
            case live.FollowParameters(op="subscribeParameterUpdates"):
                self._follows |= self._values(asked.names).keys()
            case live.FollowParameters():
                self._follows -= self._values(asked.names).keys()
        return []

    def _subscribe(self, asked: live.Subscribe) -> list[str]:
        answers, before = [], len(self.subscriptions)
        for wanted in asked.subscriptions:
            if wanted.channel not in self._channels:
                answers.append(live.status(live.Level.ERROR, f"there is no channel {wanted.channel}"))
            elif wanted.channel in self.subscriptions:
                answers.append(live.status(live.Level.WARNING, f"already subscribed to channel {wanted.channel}"))
            else:
                self.subscriptions[wanted.channel] = wanted.id
                if self._channels[wanted.channel].constant:
                    self.lacking.add(wanted.channel)
        if len(self.subscriptions) > before:
            self._on_subscription(True)
        return answers

    def _set_parameters(self, asked: live.SetParameters) -> list[str]:
        """Request a viewer's changes; return the answers, with current values for refused parameters."""
        answers, names = [], [wish.name for wish in asked.parameters]
        if self._may_tune:
            for wish in asked.parameters:
                try:
                    self._tuning.request(wish.name, wish.value)
                except InputRefused as refusal:
                    answers.append(live.status(live.Level.WARNING, f"refused: {refusal}"))
            self._on_change(names)
        else:
            answers.append(live.status(live.Level.WARNING, READ_ONLY_REFUSAL))
        if asked.id is not None and names:
            answers.append(live.parameter_values(self._values(names), asked.id))
        return answers

    def _values(self, names: Collection[str]) -> dict[str, bool | float | str]:
        """Return the values of the requested parameters that exist; of all if no name is given."""
        return {name: value for name, value in self._tuning.values().items() if name in names or not names}


_SILENT_LOGGER.setLevel(logging.CRITICAL + 1)
# asyncio's own warning that a viewer disconnected while several of its pings were answered at once
logging.getLogger("asyncio").addFilter(lambda record: record.msg != "socket.send() raised exception.")


class Broadcast:
    """The live server of one run, in a thread of its own; it listens at `port` once constructed.

    Attributes:
        news: messages about refused connections; None marks the first subscription.
        wanted: channels with a subscriber.
        lacking: constant channels whose message a subscriber still lacks.

    Raises:
        OSError: the port is taken.
    """

    def __init__(self, port: int, gate: Gate, channels: Sequence[live.Channel], tuning: Parameters):
        self.news: SimpleQueue[str | None] = SimpleQueue()
        self.wanted: frozenset[int] = frozenset()
        self.lacking: frozenset[int] = frozenset()
        self.port, self._gate, self._tuning = port, gate, tuning
        self._channels = {channel.number: channel for channel in channels}
        self._greeting = (live.server_info(str(time.time_ns())), live.advertisement(channels))
        self._clients: set[Client] = set()
        self._refused: set[str] = set()
        self._begun = False
        self._over = asyncio.Event()
        self._started: Future[asyncio.AbstractEventLoop] = Future()
        self._thread = threading.Thread(target=lambda: asyncio.run(self._serve()), daemon=True)
        self._thread.start()
        self._loop = self._started.result()

    def publish(self, time: int, messages: Sequence[live.Message]) -> None:
        """Send every viewer the simulated `time` (ns) and the messages of its subscribed channels."""
        self._loop.call_soon_threadsafe(self._send_messages, time, messages)

    def send_parameters(self, names: Sequence[str]) -> None:
        """Send every viewer the values of changed parameters that it follows."""
        self._loop.call_soon_threadsafe(self._on_change, names)

    def close(self) -> None:
        """Send queued messages, close all viewers' connections and release the port, within `SHUTDOWN_TIMEOUT` s."""
        # the event loop may have ended before
        with suppress(RuntimeError):
            self._loop.call_soon_threadsafe(self._over.set)
        self._thread.join(SHUTDOWN_TIMEOUT)

    async def _serve(self) -> None:
        try:
            # not as a context manager, whose exit waits for viewers that do not read
            server = await serve(
                self._serve_client,
                LOOPBACK_HOST,
                self.port,
                subprotocols=live.SUBPROTOCOLS,
                process_request=self._admit,
                # compressed, a small message could expand to a large one, and compression costs the stepping thread
                # time
                compression=None,
                max_size=MAX_MESSAGE_BYTES,
                close_timeout=CLOSE_TIMEOUT,
                logger=_SILENT_LOGGER,
            )
        except OSError as problem:
            self._started.set_exception(problem)
            return
        self.port = next(iter(server.sockets)).getsockname()[1]
        self._started.set_result(asyncio.get_running_loop())
        await self._over.wait()
        # new connections are refused from now on
        server.close(close_connections=False)
        await asyncio.gather(*(client.drain_and_close(CLOSE_TIMEOUT) for client in self._clients))
        for client in self._clients:
            client.cut_off()
        # for connections without a request yet; remaining ones are cancelled with the loop
        with suppress(TimeoutError):
            await asyncio.wait_for(server.wait_closed(), CLOSE_TIMEOUT)

    def _admit(self, connection: ServerConnection, request: Request) -> Response | None:
        """Return an HTTP error response for a viewer's connection that is refused; None to accept it."""
        if refusal := self._gate.refusal(request.headers):
            if refusal not in self._refused and len(self._refused) < MAX_REFUSALS:
                self._refused.add(refusal)
                self.news.put(refusal)
            return connection.respond(HTTPStatus.FORBIDDEN, f"{refusal}\n")
        if len(self._clients) >= MAX_VIEWERS:
            return connection.respond(HTTPStatus.SERVICE_UNAVAILABLE, f"{MAX_VIEWERS} viewers are connected already\n")
        return None

    async def _serve_client(self, connection: ServerConnection) -> None:
        assert connection.request is not None
        knows = self._gate.knows(connection.request.path)
        client = Client(connection, knows is True, self._channels, self._tuning, self._on_subscription, self._on_change)
        greeting = list(self._greeting)
        if knows is False:
            greeting.append(live.status(live.Level.WARNING, "the token belongs to another run: watching only"))
        self._clients.add(client)
        try:
            await client.serve(greeting)
        finally:
            self._clients.remove(client)
            self._update_subscriptions()

    def _update_subscriptions(self) -> None:
        self.wanted = frozenset(channel for client in self._clients for channel in client.subscriptions)
        self.lacking = frozenset(channel for client in self._clients for channel in client.lacking)

    def _on_subscription(self, more: bool) -> None:
        self._update_subscriptions()
        if more and not self._begun:
            self._begun = True
            self.news.put(None)

    def _on_change(self, names: Sequence[str]) -> None:
        for client in self._clients:
            client.send_parameters(names)

    def _send_messages(self, time: int, messages: Sequence[live.Message]) -> None:
        for client in self._clients:
            client.send_messages(time, messages)
        if self.lacking:
            self._update_subscriptions()


class LiveServer:
    """Live viewer that serves runs over WebSocket; a context manager whose exit sends all published messages.

    Each run is a separate broadcast at the same port, with the same token. Viewers reconnect by themselves; before the
    first run a socket that does not listen reserves the port.

    Args:
        port: port to listen on; 0 for any free one.
        say: receives texts for the user: the address, `ws://127.0.0.1:8765/?token=...`, and refused connections.
        origins: see `viewer_policy`.
        waits: whether a run waits for its first viewer; a real robot does not.

    Raises:
        InputRefused: the port is taken, or one of `origins` is invalid.
    """

    def __init__(self, port: int, say: Callable[[str], None], origins: Sequence[str] = (), waits: bool = True):
        self._say, self._gate, self._waits = say, Gate(viewer_policy(origins)), waits
        self._held = socket.socket()
        if os.name == "posix":
            # connections of a previous session must not block the port for a minute
            self._held.setsockopt(socket.SOL_SOCKET, socket.SO_REUSEADDR, 1)
        try:
            self._held.bind((LOOPBACK_HOST, port))
        except OSError as problem:
            self._held.close()
            raise _refusal(port, problem) from None
        self._port = self._held.getsockname()[1]
        self._active: tuple[Broadcast, Publisher | None] | None = None

    def __enter__(self) -> Self:
        return self

    def __exit__(self, *failure: object) -> None:
        self._held.close()
        self._close_broadcast()

    def begin(self, streams: Sequence[RowStream], scene: SceneSource, tick: float, tuning: Parameters) -> None:
        """Begin to serve a run, and wait for the first viewer's subscription if required."""
        self._held.close()
        self._close_broadcast()
        topics = Topics(streams, scene, tick)
        try:
            broadcast = Broadcast(self._port, self._gate, topics.channels, tuning)
        except OSError as problem:
            raise _refusal(self._port, problem) from None
        self._active = broadcast, None
        begins = "the run begins when a viewer subscribes" if self._waits else "viewers may come and go"
        self._say(f"serving ws://{LOOPBACK_HOST}:{self._port}/?token={self._gate.token}; {begins}")
        if self._waits:
            for refusal in iter(broadcast.news.get, None):
                self._say(f"refused: {refusal}")
        self._active = broadcast, Publisher(topics, broadcast)

    def show(self, first: int, rows: np.ndarray, events: Sequence[TickEvent]) -> None:
        """Pass the first row of the run, the newest row and every event to the publisher."""
        if self._active and self._active[1]:
            if len(rows):
                self._active[1].add_rows(first, rows, events)
            news = self._active[0].news
            while not news.empty():
                if refusal := news.get():
                    self._say(f"refused: {refusal}")

    def send_parameters(self, names: Sequence[str]) -> None:
        """Send viewers the values of parameters that changed without a viewer's request."""
        if self._active:
            self._active[0].send_parameters(names)

    def _close_broadcast(self) -> None:
        if self._active:
            broadcast, publisher = self._active
            if publisher:
                publisher.finish()
            broadcast.close()
            self._active = None


def _refusal(port: int, problem: Exception) -> InputRefused:
    return InputRefused(f"--port {port}: {problem}; choose another one, or 0 for any that is free")


class Publisher:
    """Publisher of one run's newest rows to live viewers, in a thread that starts at once.

    The stepping thread only stores its newest row here; this thread fetches it periodically, independent of the run's
    pace. Encoding messages in the stepping thread would cost it much more time. The first row is always published, so
    that waiting viewers see the beginning of a fast run.
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

    def add_rows(self, first: int, rows: np.ndarray, events: Sequence[TickEvent]) -> None:
        """Queue events for live viewers, and store the last row as the newest one."""
        if events:
            self._happened.extend(events)
        if self._first is None:
            self._first = (first, rows[0].copy())
        # one assignment is atomic, so the other thread sees either the old pair or the new one
        self._newest = (first + len(rows) - 1, rows[-1].copy())

    def finish(self) -> None:
        """Publish the last row of the run to live viewers and stop the thread."""
        self._finished.set()
        self._thread.join()

    def _work(self) -> None:
        while not self._finished.wait(MESSAGE_INTERVAL):
            self._publish()
        self._publish()

    def _publish(self) -> None:
        newest = self._newest
        if newest is None:
            return
        if self._first is not None and self._published < 0:
            self._send(*self._first, [])
        # a robot without new samples may still have events
        if newest[0] > self._published or self._happened:
            self._send(*newest, [self._happened.popleft() for _ in range(len(self._happened))])

    def _send(self, tick: int, row: np.ndarray, events: Sequence[TickEvent]) -> None:
        messages = self._topics.messages(tick, row, events, self._broadcast.wanted, self._broadcast.lacking)
        self._broadcast.publish(self._topics.time(tick), list(messages))
        self._published = tick
