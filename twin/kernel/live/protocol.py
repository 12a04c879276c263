"""Foxglove's WebSocket protocol: what a server says, and what viewers ask.

Source: https://github.com/foxglove/ws-protocol/blob/main/docs/spec.md. The protocol has two names: the SDK's, and the
one before, which older viewers ask for; what is said is the same.
"""

import json
import struct
from base64 import b64encode
from collections.abc import Mapping, Sequence
from enum import IntEnum
from typing import Annotated, Any, Literal, NamedTuple

from pydantic import BaseModel, ConfigDict, Field, TypeAdapter, ValidationError
from websockets.typing import Subprotocol

from twin.kernel.errors import InputRefused

SUBPROTOCOLS = (Subprotocol("foxglove.sdk.v1"), Subprotocol("foxglove.websocket.v1"))
_MESSAGE_DATA, _TIME = 1, 2


class Level(IntEnum):
    """Of a status."""

    INFO = 0
    WARNING = 1
    ERROR = 2


class Channel(NamedTuple):
    """A topic: its number here, its name, its type, the description of that (FileDescriptorSet), what fields mean.

    What is published in a `constant` one never changes: each viewer gets it once.
    """

    number: int
    topic: str
    type_name: str
    descriptors: bytes
    metadata: dict[str, str]
    constant: bool = False


class Message(NamedTuple):
    """Of a channel, at a simulated time (ns); protobuf."""

    channel: int
    time: int
    content: bytes


def server_info(session: str) -> str:
    """The first message: a viewer that comes back and finds another `session` forgets what it has seen."""
    capabilities = ["time", "parameters", "parametersSubscribe"]
    return _said("serverInfo", name="twin", capabilities=capabilities, metadata={}, sessionId=session)


def advertisement(channels: Sequence[Channel]) -> str:
    """Which channels there are."""
    return _said(
        "advertise",
        channels=[
            {
                "id": channel.number,
                "topic": channel.topic,
                "encoding": "protobuf",
                "schemaName": channel.type_name,
                "schemaEncoding": "protobuf",
                "schema": b64encode(channel.descriptors).decode(),
                "metadata": channel.metadata,
            }
            for channel in channels
        ],
    )


def parameter_values(values: Mapping[str, float], request: str | None = None) -> str:
    """Parameters, in answer to the `request` of that id."""
    # without the type a whole number would come back as one, and then never again take a fraction
    told = [{"name": name, "value": value, "type": "float64"} for name, value in values.items()]
    return _said("parameterValues", parameters=told, **({} if request is None else {"id": request}))


def status(level: Level, text: str) -> str:
    """A sentence for whoever sits before the viewer."""
    return _said("status", level=int(level), message=text)


def time_now(time: int) -> bytes:
    """Simulated time (ns)."""
    return struct.pack("<BQ", _TIME, time)


def message_data(subscription: int, message: Message) -> bytes:
    """`message` for whoever has given it this number."""
    return struct.pack("<BIQ", _MESSAGE_DATA, subscription, message.time) + message.content


class _Request(BaseModel):
    """What a viewer says; what we have no use for is not looked at."""

    model_config = ConfigDict(strict=True, extra="ignore")


Number = Annotated[int, Field(ge=0, lt=2**32)]


class Subscription(_Request):
    """A number of the viewer's choice for a channel."""

    id: Number
    channel: Number = Field(alias="channelId")


class Subscribe(_Request):
    op: Literal["subscribe"]
    subscriptions: list[Subscription]


class Unsubscribe(_Request):
    op: Literal["unsubscribe"]
    ids: list[Number] = Field(alias="subscriptionIds")


class AskParameters(_Request):
    """No names: all of them."""

    op: Literal["getParameters"]
    names: list[str] = Field(alias="parameterNames")
    id: str | None = None


class Wish(_Request):
    """A parameter as it shall be; without a value, as it shall not be."""

    name: str
    value: Any = None


class SetParameters(_Request):
    op: Literal["setParameters"]
    parameters: list[Wish]
    id: str | None = None


class FollowParameters(_Request):
    op: Literal["subscribeParameterUpdates", "unsubscribeParameterUpdates"]
    names: list[str] = Field(alias="parameterNames")


Request = Subscribe | Unsubscribe | AskParameters | SetParameters | FollowParameters
_REQUESTS: TypeAdapter[Request] = TypeAdapter(Annotated[Request, Field(discriminator="op")])


def request(said: str) -> Request:
    """What a viewer asks.

    Raises:
        InputRefused: nothing that this server knows.
    """
    try:
        return _REQUESTS.validate_json(said)
    except ValidationError as mistake:
        first = mistake.errors(include_url=False)[0]
        place = ".".join(str(part) for part in first["loc"])
        raise InputRefused(f"not understood: {place}{': ' if place else ''}{first['msg']}") from None


def _said(op: str, **content: Any) -> str:
    return json.dumps({"op": op, **content})
