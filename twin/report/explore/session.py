"""Client of a `twin shadow --live` session: shows its robot in the explorer, and accepts its proposals.

The server, not the page, is the viewer of the session, so the page's content policy stays unchanged, and the token of
the session reaches no browser.
"""

import asyncio
import base64
import itertools
import json
import math
import re
import socket
import struct
from array import array
from collections import deque
from itertools import pairwise
from typing import Any

from google.protobuf.descriptor_pb2 import FileDescriptorSet
from google.protobuf.descriptor_pool import DescriptorPool
from google.protobuf.message import DecodeError, Message
from google.protobuf.message_factory import GetMessageClass
from websockets.asyncio.client import ClientConnection, connect
from websockets.exceptions import ConnectionClosed, InvalidStatus, WebSocketException

from twin.kernel.errors import InputRefused, terminal_text
from twin.kernel.gate import LOOPBACK_HOST
from twin.kernel.live import SUBPROTOCOLS, parse_message_data
from twin.studies.shadow import ACCEPT_PARAMETER, ACCEPTED_PARAMETER, LINE_PARAMETER, PROPOSAL_PARAMETER

ADDRESS_PATTERN = re.compile(r"ws://(?:localhost|127\.0\.0\.1|\[::1\]):([0-9]{1,5})/?(\?token=[\w-]+)?")
RETRY_INTERVAL = 2.0
"""Time between two attempts to connect (s)."""
ANSWER_TIMEOUT = 5.0
"""Timeout of an answer (s)."""
CLOSE_TIMEOUT = 1.0
"""Timeout of closing a connection (s)."""
MAX_MESSAGE_BYTES = 2**22
"""Maximum size of a message (bytes); the list of topics with their types is the longest."""
STRIP_SPAN, STRIP_STEP = 20.0, 0.05
"""Time span and sampling period of the force strip (s)."""
STRIP_SAMPLES = round(STRIP_SPAN / STRIP_STEP) + 1
MAX_HOLD_TIME = 1.0
"""Maximum time (s) from a sample to the next one; a longer gap stays empty."""
FORCE_CURVES = {"/estimator": "robot, by its counts", "/plant": "twin", "/scale": "measured"}
"""Topic -> label of its pressing force in the strip."""
EVENTS_TOPIC, ALARM_TOPIC = "/events", "/alarm"
MAX_EVENTS = 3
TOKEN_REMEDY = "Start twin explore again with the whole address that twin shadow has printed."

PROTOCOL_ERRORS = (
    ValueError, LookupError, TypeError, AttributeError, RecursionError, OverflowError, DecodeError, struct.error,
)  # fmt: skip
"""Exceptions caused by a message that does not follow twin's protocol."""


class NoSession(Exception):
    """Error that the peer is not a session of twin shadow; the argument is an error message."""


class ForceStrip:
    """Pressing forces of a session's last `STRIP_SPAN`, on a time grid of `STRIP_STEP`, for the page."""

    def __init__(self) -> None:
        self._columns: dict[str, dict[int, float]] = {topic: {} for topic in FORCE_CURVES}
        self._newest = 0

    def add(self, topic: str, t: float, force: float) -> None:
        """Add a pressing force (N) at `t` (s), usually later than the previous ones."""
        at, column = round(t / STRIP_STEP), self._columns[topic]
        self._newest = max(self._newest, at)
        column[at] = force
        while (first := next(iter(column))) <= self._newest - STRIP_SAMPLES:
            del column[first]

    def to_dict(self) -> dict[str, Any]:
        """Return the available force curves and their concatenated samples, NaN in gaps, JSON-serialisable."""
        block, names = array("f"), []
        for topic, column in self._columns.items():
            if any(map(math.isfinite, column.values())):
                names.append(FORCE_CURVES[topic])
                block.extend(self._hold_samples(column))
        samples = base64.b64encode(block.tobytes()).decode()
        return {"curves": names, "count": STRIP_SAMPLES, "span": STRIP_SPAN, "block": samples}

    def _hold_samples(self, column: dict[int, float]) -> list[float]:
        found, first = [math.nan] * STRIP_SAMPLES, self._newest - STRIP_SAMPLES + 1
        there = sorted((at, force) for at, force in column.items() if at >= first)
        for (at, force), (end, _) in pairwise([*there, (self._newest + 1, math.nan)]):
            holds = end - at if (end - at) * STRIP_STEP <= MAX_HOLD_TIME else 1
            found[at - first : at - first + holds] = [force] * holds
        return found


class LiveSession:
    """Viewer of a running `twin shadow` session, at the address that `--live` printed, while the explorer lives.

    `version` counts received messages. `accepted` are parameters, see `twin.studies.shadow.live_view.accepted_values`.
    """

    def __init__(self, address: str):
        found = ADDRESS_PATTERN.fullmatch(address.strip())
        if not found or int(found[1]) > 65535:
            # the part after the question mark may be a token, which must not be printed
            got = address.strip().partition("?")[0]
            raise InputRefused(
                f"--follow {got!r}: expected the address that twin shadow --live has printed, "
                f"ws://{LOOPBACK_HOST}:8765/?token=..."
            )
        self._port, self._token = int(found[1]), found[2] or ""
        self.name, self.version = f"ws://{LOOPBACK_HOST}:{self._port}", 0
        self._connection: ClientConnection | None = None
        self._problem = f"Connecting to {self.name}."
        self._lock, self._ids = asyncio.Lock(), itertools.count()
        self._answer: tuple[str, asyncio.Future[str]] | None = None
        self._begin_anew()

    def _begin_anew(self) -> None:
        self._values: dict[str, Any] = {}
        self._types: dict[str, tuple[int, type[Message]]] = {}
        self._topics: dict[int, str] = {}
        self._strip, self._events = ForceStrip(), deque[str](maxlen=MAX_EVENTS)
        self._refusal, self.accepted = "", list[dict[str, Any]]()
        self._watches = "" if self._token else f"Watching only: --follow has no token. {TOKEN_REMEDY}"

    def to_dict(self) -> dict[str, Any]:
        silent = "" if EVENTS_TOPIC not in self._types or ALARM_TOPIC in self._types else (
            "No alarms, and so no proposals: twin shadow runs without an alarm; its output states the reason."
        )  # fmt: skip
        return {
            "problem": self._problem,
            "watches": self._watches,
            "line": str(self._values.get(LINE_PARAMETER, "")),
            "none": silent or "No proposal.",
            "proposal": str(self._values.get(PROPOSAL_PARAMETER, "")),
            "asked": self._values.get(ACCEPT_PARAMETER) is True,
            "accepted": [one["text"] for one in self.accepted],
            "events": list(self._events),
            **self._strip.to_dict(),
        }

    async def attend(self) -> None:
        """Listen to the `twin shadow` session, and reconnect whenever the connection ends; runs forever."""
        while True:
            self._problem = terminal_text(await self._listen())
            self._connection = None
            self._resolve(self._problem)
            self.version += 1
            await asyncio.sleep(RETRY_INTERVAL)

    async def _listen(self) -> str:
        """Listen to the session until the connection ends; return the reason as a sentence."""
        found = False
        try:
            with socket.socket() as there:
                there.setblocking(False)
                # connect to the loopback address whatever host name was given
                await asyncio.get_running_loop().sock_connect(there, (LOOPBACK_HOST, self._port))
                async with connect(
                    f"{self.name}/{self._token}", sock=there, subprotocols=SUBPROTOCOLS, compression=None,
                    max_size=MAX_MESSAGE_BYTES, open_timeout=ANSWER_TIMEOUT, ping_interval=ANSWER_TIMEOUT,
                    ping_timeout=ANSWER_TIMEOUT, close_timeout=CLOSE_TIMEOUT,
                ) as connection:  # fmt: skip
                    await self._greet(connection)
                    found = True
                    async for frame in connection:
                        self._receive_frame(frame)
                        self.version += 1
        except NoSession as other:
            return str(other)
        except InvalidStatus as refusal:
            return f"{self.name} refuses: {(refusal.response.body or b'').decode(errors='replace').strip()[:200]}"
        except PROTOCOL_ERRORS:
            return self._protocol_error_text()
        except TimeoutError:
            return f"{self.name} does not answer: twin shadow hangs, or another program is there. Trying again."
        except WebSocketException:
            if not found:
                return self._protocol_error_text()
        except OSError:
            if not found:
                return f"Nothing answers at {self.name}: start twin shadow with --live. Trying again."
        return f"The connection to {self.name} is lost: twin shadow has ended, or hangs. Trying again."

    def _protocol_error_text(self) -> str:
        return f"The server at {self.name} is not a live server of twin; expected twin shadow --live. Trying again."

    async def _greet(self, connection: ClientConnection) -> None:
        """Identify the peer and subscribe to the session's topics; a run is not subscribed, as that would start it."""
        self._begin_anew()
        async with asyncio.timeout(ANSWER_TIMEOUT):
            first = await _next_text(connection)
            if (first["op"], first["name"]) != ("serverInfo", "twin"):
                raise NoSession(self._protocol_error_text())
            # subscribe before reading, so that no change is missed
            await connection.send(json.dumps({"op": "subscribeParameterUpdates", "parameterNames": []}))
            await connection.send(json.dumps({"op": "getParameters", "parameterNames": [], "id": "all"}))
            answer: dict[str, Any] = {}
            while answer.get("id") != "all":
                answer = await _next_text(connection)
                self._on_message(answer)
        if PROPOSAL_PARAMETER not in self._values:
            raise NoSession(
                f"{self.name} serves a run (twin run --live), which follows no robot and proposes nothing; expected "
                "twin shadow --live. Trying again."
            )
        if self._refusal:
            self._watches = f"Watching only: the token of --follow is not that of this session. {TOKEN_REMEDY}"
        wanted = [topic for topic in (*FORCE_CURVES, EVENTS_TOPIC) if topic in self._types]
        self._topics = {self._types[topic][0]: topic for topic in wanted}
        subscriptions = [{"id": number, "channelId": number} for number in self._topics]
        await connection.send(json.dumps({"op": "subscribe", "subscriptions": subscriptions}))
        self._connection, self._problem = connection, ""
        self.version += 1

    def _receive_frame(self, frame: str | bytes) -> None:
        if isinstance(frame, str):
            self._on_message(json.loads(frame))
            return
        if (data := parse_message_data(frame)) is None:
            return
        number, time, content = data
        topic, t = self._topics[number], 1e-9 * time
        message: Any = self._types[topic][1].FromString(content)
        if topic == EVENTS_TOPIC:
            self._events.append(f"{t:.1f} s  {terminal_text(message.message)}")
        else:
            self._strip.add(topic, t, message.F_z if topic == "/scale" else -message.F_ee_B[2])

    def _on_message(self, news: dict[str, Any]) -> None:
        if news["op"] == "advertise":
            self._types |= {one["topic"]: (one["id"], _message_type(one)) for one in news["channels"]
                            if one["topic"] in (*FORCE_CURVES, EVENTS_TOPIC, ALARM_TOPIC)}  # fmt: skip
        elif news["op"] == "status":
            self._refusal = str(news["message"])
        elif news["op"] == "parameterValues":
            self._values |= {one["name"]: one["value"] for one in news["parameters"]}
            self.accepted = [{"text": str(one["text"]), "field": str(one["field"]), "leg": int(one["leg"]),
                              "value": float(one["value"])}
                             for one in json.loads(self._values.get(ACCEPTED_PARAMETER, "[]"))]  # fmt: skip
            if self._answer and news.get("id") == self._answer[0]:
                self._resolve(self._refusal)

    def _resolve(self, text: str) -> None:
        if self._answer and not self._answer[1].done():
            self._answer[1].set_result(text)

    async def accept(self, proposal: object) -> str:
        """Forward the user's acceptance of `proposal` to the twin. Return an error message, or ""."""
        async with self._lock:
            if self._connection is None or self._watches:
                return self._problem or self._watches
            if not proposal or proposal != self._values[PROPOSAL_PARAMETER]:
                return "Not accepted: twin does not propose that any more."
            self._refusal, number = "", f"accept {next(self._ids)}"
            self._answer = number, asyncio.get_running_loop().create_future()
            wish = {"name": ACCEPT_PARAMETER, "value": True}
            try:
                async with asyncio.timeout(ANSWER_TIMEOUT):
                    await self._connection.send(json.dumps({"op": "setParameters", "parameters": [wish], "id": number}))
                    return terminal_text(await self._answer[1])
            except (TimeoutError, ConnectionClosed):
                return f"{self.name} does not answer."


async def _next_text(connection: ClientConnection) -> dict[str, Any]:
    """Receive the next text message of the session; earlier binary messages are dropped, such as the time."""
    while isinstance(frame := await connection.recv(), bytes):
        pass
    found: dict[str, Any] = json.loads(frame)
    return found


def _message_type(channel: dict[str, Any]) -> type[Message]:
    pool = DescriptorPool()
    for file in FileDescriptorSet.FromString(base64.b64decode(channel["schema"])).file:
        pool.Add(file)
    found: type[Message] = GetMessageClass(pool.FindMessageTypeByName(channel["schemaName"]))
    return found
