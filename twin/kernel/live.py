"""Foxglove's WebSocket protocol: messages of the live server and requests of its viewers."""

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
_MESSAGE_OPCODE, _TIME_OPCODE = 1, 2
_MESSAGE_HEAD = struct.Struct("<BIQ")
"""Front of message data: opcode, subscription, time."""
Number = Annotated[int, Field(ge=0, lt=2**32)]


class Level(IntEnum):
    """Severity of a status message to viewers."""

    INFO = 0
    WARNING = 1
    ERROR = 2


class Channel(NamedTuple):
    """A channel of the live server: number, topic, message type, FileDescriptorSet of the type, field -> meaning.

    The message of a `constant` channel never changes: each viewer gets it once.
    """

    number: int
    topic: str
    type_name: str
    descriptors: bytes
    metadata: dict[str, str]
    constant: bool = False


class Message(NamedTuple):
    """A protobuf message of a live channel, at a simulation time (ns)."""

    channel: int
    time: int
    content: bytes


def server_info(session: str) -> str:
    """Encode the first message to a viewer; a viewer that reconnects to another `session` clears its data."""
    capabilities = ["time", "parameters", "parametersSubscribe"]
    return _message("serverInfo", name="twin", capabilities=capabilities, metadata={}, sessionId=session)


def advertisement(channels: Sequence[Channel]) -> str:
    """Encode the list of channels that the live server offers to viewers."""
    return _message(
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


def parameter_values(values: Mapping[str, bool | float | str], request: str | None = None) -> str:
    """Encode parameters and their values for a viewer, in response to its `request` of that id."""
    # without the type a viewer would return a whole number as an integer and then refuse fractions
    listed = [
        {"name": name, "value": value} | ({} if isinstance(value, bool | str) else {"type": "float64"})
        for name, value in values.items()
    ]
    return _message("parameterValues", parameters=listed, **({} if request is None else {"id": request}))


def status(level: Level, text: str) -> str:
    """Encode a status message (error, warning or note) for the viewer's user."""
    return _message("status", level=int(level), message=text)


def time_message(time: int) -> bytes:
    """Encode the simulation time (ns) as a message to viewers."""
    return struct.pack("<BQ", _TIME_OPCODE, time)


def message_data(subscription: int, message: Message) -> bytes:
    """Encode `message` as a frame for a viewer's subscription number."""
    return _MESSAGE_HEAD.pack(_MESSAGE_OPCODE, subscription, message.time) + message.content


def parse_message_data(frame: bytes) -> tuple[int, int, bytes] | None:
    """Decode a data frame into (subscription, simulation time (ns), content); None for a frame of another kind."""
    if frame[:1] != bytes([_MESSAGE_OPCODE]) or len(frame) < _MESSAGE_HEAD.size:
        return None
    _, subscription, time = _MESSAGE_HEAD.unpack_from(frame)
    return subscription, time, frame[_MESSAGE_HEAD.size :]


class _Request(BaseModel):
    model_config = ConfigDict(strict=True, extra="ignore")


class Subscription(_Request):
    """A viewer's subscription to a channel, under a number that the viewer chooses."""

    id: Number
    channel: Number = Field(alias="channelId")


class Subscribe(_Request):
    op: Literal["subscribe"]
    subscriptions: list[Subscription]


class Unsubscribe(_Request):
    op: Literal["unsubscribe"]
    ids: list[Number] = Field(alias="subscriptionIds")


class GetParameters(_Request):
    """A viewer's request for the values of parameters; of all if it lists no names."""

    op: Literal["getParameters"]
    names: list[str] = Field(alias="parameterNames")
    id: str | None = None


class ParameterRequest(_Request):
    """A viewer's request for a new value of a parameter; None to remove the parameter."""

    name: str
    value: Any = None


class SetParameters(_Request):
    op: Literal["setParameters"]
    parameters: list[ParameterRequest]
    id: str | None = None


class FollowParameters(_Request):
    op: Literal["subscribeParameterUpdates", "unsubscribeParameterUpdates"]
    names: list[str] = Field(alias="parameterNames")


Request = Subscribe | Unsubscribe | GetParameters | SetParameters | FollowParameters
_REQUEST_ADAPTER: TypeAdapter[Request] = TypeAdapter(Annotated[Request, Field(discriminator="op")])


def parse_request(text: str) -> Request:
    """Parse a viewer's JSON request; raise InputRefused if unknown or invalid."""
    try:
        return _REQUEST_ADAPTER.validate_json(text)
    except ValidationError as mistake:
        first = mistake.errors(include_url=False)[0]
        place = ".".join(str(part) for part in first["loc"])
        raise InputRefused(f"not understood: {place}{': ' if place else ''}{first['msg']}") from None


def _message(op: str, **content: Any) -> str:
    return json.dumps({"op": op, **content})
