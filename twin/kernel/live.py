"""Access control of the live server: who may connect and who may tune, decided from the head of the first request.

A browser lets any page open a WebSocket to this machine, and says whose page it is only in Origin; so that header has
to be looked at here. Host has to be ours because a page may give its own name our address ("DNS rebinding"). A page
cannot forge either. Programs can, and may watch; to tune takes the token, which only the terminal has shown.

Sources: RFC 6455, 10.2 (Origin); RFC 6454 (origins).
"""

import json
import re
import secrets
import struct
from base64 import b64encode
from collections.abc import Mapping, Sequence
from enum import IntEnum
from typing import Annotated, Any, Literal, NamedTuple
from urllib.parse import parse_qs, urlsplit

from pydantic import BaseModel, ConfigDict, Field, TypeAdapter, ValidationError
from websockets.datastructures import Headers
from websockets.typing import Subprotocol

from twin.kernel.errors import InputRefused

HOST = "127.0.0.1"
"""This machine's own address: no other one reaches a server that listens there."""
HERE = r"(localhost|127\.0\.0\.1|\[::1\])(:[0-9]{1,5})?"
VIEWERS = ("https://app.foxglove.dev", "https://lichtblick-suite.github.io", "file://")
"""Origins of Foxglove's and Lichtblick's pages, and of their desktop programs, which are pages out of a file."""


class Gate:
    """Asked about every connection.

    Args:
        origins: that are let in besides `VIEWERS`, pages of this machine and programs, which have none.

    Attributes:
        token: a viewer that sends it may tune.

    Raises:
        InputRefused: one of `origins` is none.
    """

    def __init__(self, origins: Sequence[str] = ()):
        self.token = secrets.token_urlsafe(16)
        for origin in origins:
            if not re.fullmatch(r"[a-z][a-z0-9+.-]*://[^\s/?#@*]*", origin.lower()):
                raise InputRefused(f"--origin {origin}: expected scheme://host or scheme://host:port, without a path")
        self._origins = {*VIEWERS, *(origin.lower() for origin in origins)}

    def refusal(self, headers: Headers) -> str:
        """Why a connection with these headers is refused, for people; "" if it is not."""
        hosts, origins = headers.get_all("Host"), headers.get_all("Origin")
        if len(hosts) != 1 or not re.fullmatch(HERE, hosts[0].lower()):
            return f"Host {', '.join(hosts)}: not a name of this machine's own address; open ws://127.0.0.1"
        origin = origins[0].lower() if len(origins) == 1 else ""
        if not origins or origin in self._origins or re.fullmatch(rf"https?://{HERE}", origin):
            return ""
        named = ", ".join(origins)
        return f"a page of {named}: not an origin that may watch; --origin {named} lets it in"

    def knows(self, path: str) -> bool | None:
        """Whether the `path` of a request names the token; None if it names none at all."""
        try:
            named = parse_qs(urlsplit(path).query).get("token")
        # a path such as //[
        except ValueError:
            return None
        if named is None:
            return None
        return any(same_token(each, self.token) for each in named)


def same_token(given: str, token: str) -> bool:
    """Whether `given` is the token; how long that takes says nothing about it."""
    return secrets.compare_digest(given.encode(), token.encode())


class OwnPageGate:
    """Asked about every request to a server of pages of its own, on which native code runs.

    Only its own origin and port are let in, and nothing is answered without the token: not the first page, no read.
    A browser brings the token in the address that the terminal shows, and from then on in a cookie that no other site's
    page can make it send (SameSite=Strict) and no script can read (HttpOnly).

    Args:
        port: of the server, which listens on 127.0.0.1.
        token: of the server.

    Attributes:
        origin: of its pages.
        cookie: name of the cookie; with the port, for cookies are those of a host.
    """

    def __init__(self, port: int, token: str):
        self.origin, self.cookie, self._token = f"http://127.0.0.1:{port}", f"twin_{port}", token

    def refusal(self, headers: Headers, changes: bool) -> str:
        """Why a request with these headers is refused, for people; "" if it is not.

        Args:
            headers: of the request.
            changes: whether it does more than read, a WebSocket say: then the browser has to say whose page asks.
        """
        hosts, origins = headers.get_all("Host"), headers.get_all("Origin")
        if len(hosts) != 1 or f"http://{hosts[0].lower()}" != self.origin:
            return f"Host {', '.join(hosts)}: expected {self.origin.removeprefix('http://')}"
        if [origin.lower() for origin in origins] != [self.origin] and (origins or changes):
            return f"a page of {', '.join(origins) or 'nowhere'}: only those of {self.origin} may ask"
        # what a page of another site asks for without saying so: pictures, scripts, links
        if any(site not in ("same-origin", "none") for site in headers.get_all("Sec-Fetch-Site")):
            return "asked for by a page of another site"
        return ""

    def knows(self, given: str | None) -> bool:
        """Whether `given`, of the address or a cookie, is the token."""
        return given is not None and same_token(given, self._token)


SUBPROTOCOLS = (Subprotocol("foxglove.sdk.v1"), Subprotocol("foxglove.websocket.v1"))
_MESSAGE_DATA, _TIME = 1, 2
_HEAD = struct.Struct("<BIQ")
"""Of message data: kind, subscription, time."""


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
    return _message("serverInfo", name="twin", capabilities=capabilities, metadata={}, sessionId=session)


def advertisement(channels: Sequence[Channel]) -> str:
    """Which channels there are."""
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
    """Parameters, in answer to the `request` of that id."""
    # without the type a whole number would come back as one, and then never again take a fraction
    listed = [
        {"name": name, "value": value} | ({} if isinstance(value, bool | str) else {"type": "float64"})
        for name, value in values.items()
    ]
    return _message("parameterValues", parameters=listed, **({} if request is None else {"id": request}))


def status(level: Level, text: str) -> str:
    """A sentence for the viewer's user."""
    return _message("status", level=int(level), message=text)


def time_now(time: int) -> bytes:
    """Simulated time (ns)."""
    return struct.pack("<BQ", _TIME, time)


def message_data(subscription: int, message: Message) -> bytes:
    """`message` for the subscription of this number."""
    return _HEAD.pack(_MESSAGE_DATA, subscription, message.time) + message.content


def unpacked_data(frame: bytes) -> tuple[int, int, bytes] | None:
    """`message_data` backwards: (subscription, simulated time (ns), content); None: a frame of another kind."""
    if frame[:1] != bytes([_MESSAGE_DATA]) or len(frame) < _HEAD.size:
        return None
    _, subscription, time = _HEAD.unpack_from(frame)
    return subscription, time, frame[_HEAD.size :]


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


def request(text: str) -> Request:
    """What a viewer asks.

    Raises:
        InputRefused: nothing that this server knows.
    """
    try:
        return _REQUESTS.validate_json(text)
    except ValidationError as mistake:
        first = mistake.errors(include_url=False)[0]
        place = ".".join(str(part) for part in first["loc"])
        raise InputRefused(f"not understood: {place}{': ' if place else ''}{first['msg']}") from None


def _message(op: str, **content: Any) -> str:
    return json.dumps({"op": op, **content})
