"""A viewer of our own: Foxglove's WebSocket protocol, spoken with the `websockets` package.

https://github.com/foxglove/ws-protocol/blob/main/docs/spec.md.
"""

import json
import socket
import struct
from base64 import b64decode
from collections.abc import Callable
from contextlib import ExitStack, suppress
from typing import Any, NamedTuple
from urllib.parse import urlsplit

from google.protobuf.descriptor_pb2 import FileDescriptorSet
from google.protobuf.descriptor_pool import DescriptorPool
from google.protobuf.message import Message
from google.protobuf.message_factory import GetMessageClass
from websockets.exceptions import ConnectionClosedError
from websockets.sync.client import ClientConnection, connect
from websockets.typing import Origin, Subprotocol

MESSAGE_DATA, TIME = 1, 2
PATIENCE = 30.0
"""s; how long to wait for anything at all, on a machine that is busy."""


def address_in(text: str) -> str:
    """The address in what a server tells."""
    return text.split()[1].rstrip(";")


class Received(NamedTuple):
    """A message of a topic: topic, log time (ns), decoded."""

    topic: str
    time: int
    message: Message


class Viewer:
    """A connection to a live run; a context manager.

    Args:
        address: of the server. origin: of the page that it pretends to be; None: it is no page.
        subprotocol: that it asks for.

    Attributes:
        channels: what the server has advertised, by topic. received: messages so far. times: server times so far (ns).
        told: JSON messages so far, without the advertisements.
        socket: the connection.
    """

    def __init__(self, address: str, origin: str | None = None, subprotocol: str = "foxglove.sdk.v1"):
        self._open = ExitStack()
        # whatever name the address has, the server is here
        there = socket.create_connection(("127.0.0.1", urlsplit(address).port or 0), timeout=PATIENCE)
        self.socket: ClientConnection = self._open.enter_context(
            connect(
                address,
                sock=there,
                origin=None if origin is None else Origin(origin),
                subprotocols=[Subprotocol(subprotocol)],
                open_timeout=PATIENCE,
            )
        )
        self.channels: dict[str, dict[str, Any]] = {}
        self.received: list[Received] = []
        self.times: list[int] = []
        self.told: list[dict[str, Any]] = []
        self._subscribed: dict[int, str] = {}
        self._types: dict[str, type[Message]] = {}

    def __enter__(self) -> "Viewer":
        return self

    def __exit__(self, *failure: object) -> None:
        self._open.close()

    def send(self, **request: Any) -> None:
        self.socket.send(json.dumps(request))

    def subscribe(self, *topics: str) -> None:
        """Subscribe as soon as they are there."""
        self.until(lambda: self.channels.keys() >= set(topics))
        wanted = [{"id": self.channels[topic]["id"], "channelId": self.channels[topic]["id"]} for topic in topics]
        self._subscribed |= {self.channels[topic]["id"]: topic for topic in topics}
        self.send(op="subscribe", subscriptions=wanted)

    def set(self, name: str, value: Any) -> None:
        self.send(op="setParameters", parameters=[{"name": name, "value": value, "type": "float64"}], id="set")

    def parameters(self) -> dict[str, float]:
        """What the server says of all of them now."""
        self.send(op="getParameters", parameterNames=[], id="all")
        self.until(lambda: bool(self.of("parameterValues", id="all")))
        return {p["name"]: p["value"] for p in self.of("parameterValues", id="all")[-1]["parameters"]}

    def of(self, op: str, **fields: Any) -> list[dict[str, Any]]:
        """JSON messages of one kind so far."""
        return [told for told in self.told if told["op"] == op and fields.items() <= told.items()]

    def messages(self, topic: str) -> list[Received]:
        """Messages of `topic` so far."""
        return [received for received in self.received if received.topic == topic]

    def until(self, condition: Callable[[], bool]) -> None:
        """Listen until `condition`."""
        while not condition():
            self._take(self.socket.recv(timeout=PATIENCE))

    def to_the_end(self) -> None:
        """Listen until the server ends the connection."""
        with suppress(ConnectionClosedError):
            for data in self.socket:
                self._take(data)

    def _take(self, data: str | bytes) -> None:
        if isinstance(data, str):
            told = json.loads(data)
            if told["op"] == "advertise":
                self.channels |= {channel["topic"]: channel for channel in told["channels"]}
            else:
                self.told.append(told)
        elif data[0] == TIME:
            self.times += struct.unpack_from("<Q", data, 1)
        elif data[0] == MESSAGE_DATA:
            subscription, time = struct.unpack_from("<IQ", data, 1)
            topic = self._subscribed[subscription]
            self.received.append(Received(topic, time, self._type(topic).FromString(data[13:])))

    def _type(self, topic: str) -> type[Message]:
        """The message class that the channel's own schema describes."""
        if topic not in self._types:
            pool = DescriptorPool()
            for file in FileDescriptorSet.FromString(b64decode(self.channels[topic]["schema"])).file:
                pool.Add(file)
            descriptor = pool.FindMessageTypeByName(self.channels[topic]["schemaName"])
            self._types[topic] = GetMessageClass(descriptor)
        return self._types[topic]
