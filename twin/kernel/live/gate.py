"""Who may connect, and who may tune: decided by the head of the first request, before anything is answered.

A browser lets any page open a WebSocket to this machine, and says whose page it is only in Origin; so that header has
to be looked at here. Host has to be ours because a page may give its own name our address ("DNS rebinding"). A page
cannot forge either. Programs can, and may watch; to tune takes the token, which only the terminal has shown.

Sources: RFC 6455, 10.2 (Origin); RFC 6454 (origins).
"""

import re
import secrets
from collections.abc import Sequence
from urllib.parse import parse_qs, urlsplit

from websockets.datastructures import Headers

from twin.kernel.errors import InputRefused

HERE = r"(localhost|127\.0\.0\.1|\[::1\])(:[0-9]{1,5})?"
VIEWERS = ("https://app.foxglove.dev", "https://lichtblick-suite.github.io", "file://")
"""Origins of Foxglove's and Lichtblick's pages, and of their desktop programs, which are pages out of a file."""


class Gate:
    """Asked about every connection.

    Args:
        origins: that are let in besides `VIEWERS`, pages of this machine and programs, which have none.

    Attributes:
        token: whoever names it may tune.

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
        return f"a page of {named}: not an origin that may watch; twin run --live --origin {named} lets it in"

    def knows(self, path: str) -> bool | None:
        """Whether the `path` of a request names the token; None if it names none at all."""
        named = parse_qs(urlsplit(path).query).get("token")
        if named is None:
            return None
        return any(secrets.compare_digest(each.encode(), self.token.encode()) for each in named)
