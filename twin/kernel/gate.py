"""Access control of the servers on this machine's loopback address, based on the headers of a request.

A browser lets any page open a WebSocket to this machine, and names the page's site only in the Origin header, so Origin
is checked here. Host is checked because a page may resolve its own name to the loopback address ("DNS rebinding").
Pages cannot forge either header; programs can.

Sources: RFC 6455, 10.2 (Origin); RFC 6454 (origins).
"""

import re
import secrets
from collections.abc import Sequence
from dataclasses import dataclass
from urllib.parse import parse_qs, urlsplit

from websockets.datastructures import Headers

from twin.kernel.errors import InputRefused

LOOPBACK_HOST = "127.0.0.1"
"""Loopback address: a server that listens there is unreachable from other machines."""
LOCAL_HOST_PATTERN = r"(localhost|127\.0\.0\.1|\[::1\])(:[0-9]{1,5})?"
VIEWER_ORIGINS = ("https://app.foxglove.dev", "https://lichtblick-suite.github.io", "file://")
"""Origins of Foxglove's and Lichtblick's pages, and of their desktop programs, which are pages loaded from a file."""


@dataclass(frozen=True)
class GatePolicy:
    """Access rules of a local server: patterns of Host and Origin headers in lower case, name of the token's cookie.

    Attributes:
        expected_host, expected_origin: ends of the error messages about other ones; ORIGIN stands for the origin.
        own_pages_only: whether a request that does more than read needs an Origin, and pages of other sites may not
            even load a picture or a script; False admits programs and links of other sites.
    """

    hosts: str
    expected_host: str
    origins: str
    expected_origin: str
    own_pages_only: bool
    cookie: str = ""


def viewer_policy(origins: Sequence[str] = ()) -> GatePolicy:
    """Return the live server's rules: viewers (also `origins`) and own pages watch; the token lets them tune."""
    for origin in origins:
        if not re.fullmatch(r"[a-z][a-z0-9+.-]*://[^\s/?#@*]*", origin.lower()):
            raise InputRefused(f"origin {origin}: expected scheme://host or scheme://host:port, without a path")
    known = "|".join(re.escape(origin.lower()) for origin in (*VIEWER_ORIGINS, *origins))
    return GatePolicy(
        hosts=LOCAL_HOST_PATTERN,
        expected_host="not a name of this machine's own address; open ws://127.0.0.1",
        origins=f"{known}|https?://{LOCAL_HOST_PATTERN}",
        expected_origin="not an origin that may watch; --origin ORIGIN lets it in",
        own_pages_only=False,
    )


def own_page_policy(port: int) -> GatePolicy:
    """Return the access rules of a server with own pages that run native code: only its origin, only with the token.

    A browser sends the token first in the address that the terminal shows, then in a cookie. Pages of other sites
    cannot make it send the cookie (SameSite=Strict), and scripts cannot read it (HttpOnly). Browsers share cookies
    between the ports of a host, so its name contains the port.
    """
    address = f"{LOOPBACK_HOST}:{port}"
    return GatePolicy(
        hosts=re.escape(address),
        expected_host=f"expected {address}",
        origins=re.escape(f"http://{address}"),
        expected_origin=f"only those of http://{address} may ask",
        own_pages_only=True,
        cookie=f"twin_{port}",
    )


class Gate:
    """Gatekeeper that checks host, origin and `token` (shown in the terminal; None for a new one) of every request."""

    def __init__(self, policy: GatePolicy, token: str | None = None):
        self.policy, self.token = policy, token or secrets.token_urlsafe(16)

    def refusal(self, headers: Headers, changes: bool = True) -> str:
        """Return why a request, which `changes` if it does more than read (a WebSocket), is refused; "" if admitted."""
        policy, hosts, origins = self.policy, headers.get_all("Host"), headers.get_all("Origin")
        if len(hosts) != 1 or not re.fullmatch(policy.hosts, hosts[0].lower()):
            return f"Host {', '.join(hosts)}: {policy.expected_host}"
        known = len(origins) == 1 and re.fullmatch(policy.origins, origins[0].lower())
        if not known and (origins or (changes and policy.own_pages_only)):
            named = ", ".join(origins) if origins else "nowhere"
            return f"a page of {named}: {policy.expected_origin.replace('ORIGIN', named)}"
        # set by browsers for pictures, scripts and links, which have no Origin
        sites = headers.get_all("Sec-Fetch-Site")
        if policy.own_pages_only and any(site not in ("same-origin", "none") for site in sites):
            return "asked for by a page of another site"
        return ""

    def knows(self, path: str) -> bool | None:
        """Whether the address `path` of a request contains the right token; None if it contains no token."""
        try:
            named = parse_qs(urlsplit(path).query).get("token")
        # a path such as //[
        except ValueError:
            return None
        return None if named is None else any(map(self._is_token, named))

    def knows_cookie(self, headers: Headers) -> bool:
        """Whether a cookie of the request carries the right token."""
        pairs = [pair.strip().partition("=") for line in headers.get_all("Cookie") for pair in line.split(";")]
        return any(name == self.policy.cookie and self._is_token(value) for name, _, value in pairs)

    def _is_token(self, given: str) -> bool:
        """Whether `given` equals the server's token, compared in constant time."""
        return secrets.compare_digest(given.encode(), self.token.encode())
