"""Who is let in, what they get, and how the server ends; the experiments behind it are stand-ins."""

import base64
import http.client
import json
import socket
import struct
import threading
import time
from collections.abc import Iterator, Mapping
from contextlib import suppress
from typing import Any, ClassVar

import numpy as np
import pytest
from websockets.exceptions import ConnectionClosed, InvalidStatus
from websockets.sync.client import ClientConnection, connect

from twin.kernel.errors import ComponentFailed, InputRefused
from twin.kernel.process.job import JobLimits
from twin.report.explore import server as explorer
from twin.report.explore.server import MAX_WAITING, ExplorerServer, lasting_token

TOKEN = "t" * 43
LINGER = 0.3


class StandIn:
    """In place of a process: answers at once, or waits until it may.

    Attributes:
        asked: all that it was asked for.
        may: cleared to make it wait.
        prompt: operations that it answers at once even so.
    """

    asked: ClassVar[list[Mapping[str, Any]]] = []
    may = threading.Event()
    prompt: ClassVar[tuple[str, ...]] = ()

    def __init__(self, limits: JobLimits):
        self.busy = False

    def close(self) -> None:
        pass

    def answer(self, base: Mapping[str, Any], ask: Mapping[str, Any], outdated: threading.Event) -> dict[str, Any]:
        assert not self.busy, "asked while it answers"
        self.busy = True
        try:
            return self.found(base, ask)
        finally:
            self.busy = False

    def found(self, base: Mapping[str, Any], ask: Mapping[str, Any]) -> dict[str, Any]:
        self.asked.append(ask)
        if ask["op"] == "begin":
            return {"refused": "no such experiment"} if ask["settings"] else {"base": dict(base), "sliders": []}
        if ask["op"] == "save":
            raise ComponentFailed("drive.fmu crashed\nmore")
        assert ask["op"] in self.prompt or self.may.wait(10)
        return {"numbers": [], "block": base64.b64encode(np.arange(3, dtype="<f4").tobytes()).decode()}


class Served:
    """A server that listens, in a thread of its own."""

    def __init__(self, session: Any = None) -> None:
        StandIn.asked, StandIn.may = [], threading.Event()
        StandIn.may.set()
        listening = socket.create_server(("127.0.0.1", 0))
        self.port = listening.getsockname()[1]
        self.server = ExplorerServer({"experiment": "x", "drive": None, "body": None}, JobLimits(), LINGER, session)
        self.server.begin([])
        self.thread = threading.Thread(target=self.server.serve, args=(listening, TOKEN), daemon=True)
        self.thread.start()
        self.cookie = f"twin_{self.port}={TOKEN}"
        self.origin = f"http://127.0.0.1:{self.port}"

    def end(self) -> None:
        StandIn.may.set()
        # it may have ended by itself, or never begun
        with suppress(RuntimeError, AttributeError):
            self.server.end()
        self.thread.join(10)

    def get(self, path: str, method: str = "GET", **headers: str) -> http.client.HTTPResponse:
        connection = http.client.HTTPConnection("127.0.0.1", self.port, timeout=10)
        connection.putrequest(method, path, skip_host="Host" in headers)
        for name, value in headers.items():
            connection.putheader(name.replace("_", "-"), value)
        connection.endheaders()
        return connection.getresponse()

    def link(self, **headers: str) -> ClientConnection:
        given = {"Cookie": self.cookie, "Origin": self.origin} | headers
        return connect(f"ws://127.0.0.1:{self.port}/link", additional_headers=given, compression=None)


def head(answer: str | bytes) -> dict[str, Any]:
    """The JSON of an answer with samples."""
    assert isinstance(answer, bytes)
    found: dict[str, Any] = json.loads(answer[4 : 4 + struct.unpack_from("<I", answer)[0]])
    return found


@pytest.fixture
def served(monkeypatch: pytest.MonkeyPatch) -> Iterator[Served]:
    monkeypatch.setattr(explorer, "AnsweringProcess", StandIn)
    found = Served()
    yield found
    found.end()


def test_the_token_in_the_address_is_given_for_a_cookie_and_leaves_the_address(served: Served):
    answer = served.get(f"/?token={TOKEN}")
    assert (answer.status, answer.getheader("Location")) == (303, "/")
    cookie = answer.getheader("Set-Cookie") or ""
    assert cookie.startswith(served.cookie) and "HttpOnly" in cookie and "samesite=strict" in cookie.lower()
    page = served.get("/", Cookie=served.cookie)
    assert page.status == 200 and b"<title>twin explore" in page.read()


@pytest.mark.parametrize(
    "path", ["/", "/explore.js", "/report.js", "/report.css", "/recorded/0", "/nothing", "/?token=x"]
)
def test_nothing_is_read_without_the_token(served: Served, path: str):
    for headers in ({}, {"Cookie": f"twin_{served.port}=wrong"}, {"Cookie": f"twin_1={TOKEN}"}):
        answer = served.get(path, **headers)
        assert answer.status == 403
        assert answer.read().startswith(b"This page is shown only to the browser")


@pytest.mark.parametrize(
    "headers",
    [
        {"Host": "evil.example"},
        {"Host": "localhost:{port}"},
        {"Host": "127.0.0.1:1"},
        {"Origin": "http://evil.example"},
        {"Origin": "http://127.0.0.1:1"},
        {"Origin": "null"},
        {"Sec_Fetch_Site": "cross-site"},
        {"Sec_Fetch_Site": "same-site"},
    ],
)
def test_other_names_other_origins_and_other_sites_get_nothing_even_with_the_token(
    served: Served, headers: dict[str, str]
):
    given = {name: value.replace("{port}", str(served.port)) for name, value in headers.items()}
    for path in (f"/?token={TOKEN}", "/"):
        assert served.get(path, Cookie=served.cookie, **given).status == 403


def test_what_does_more_than_read_has_to_say_whose_page_asks(served: Served):
    assert served.get("/", "POST", Cookie=served.cookie).status == 403
    # nothing is taken in but messages of the link
    for method in ("POST", "PUT", "DELETE", "HEAD"):
        assert served.get("/file?name=x.fmu", method, Cookie=served.cookie, Origin=served.origin).status == 405
    for headers in ({"Origin": "http://127.0.0.1:1"}, {"Cookie": "a=b"}, {"Sec-Fetch-Site": "same-site"}):
        with pytest.raises((InvalidStatus, ConnectionClosed)):
            served.link(**headers).recv(5)
    with served.link() as link:
        assert json.loads(link.recv(5))["op"] == "begin"


def test_every_answer_forbids_frames_foreign_scripts_and_being_kept(served: Served):
    for path in ("/", "/report.js"):
        answer = served.get(path, Cookie=served.cookie)
        policy = answer.getheader("Content-Security-Policy") or ""
        assert "default-src 'none'" in policy and "script-src 'self';" in policy and "frame-ancestors 'none'" in policy
        assert "unsafe" not in policy
        assert answer.getheader("Cache-Control") == "no-store"
        assert answer.getheader("Cross-Origin-Resource-Policy") == "same-origin"
        assert answer.getheader("Server") is None


def test_samples_come_as_floats_behind_the_json(served: Served):
    with served.link() as link:
        link.recv(5)
        link.send(json.dumps({"op": "show", "id": 7, "slot": 0}))
        answer = link.recv(5)
    assert isinstance(answer, bytes)
    (length,) = struct.unpack_from("<I", answer)
    assert length % 4 == 0
    assert head(answer) == {"op": "show", "id": 7, "slot": 0, "numbers": []}
    assert np.frombuffer(answer, "<f4", offset=4 + length).tolist() == [0.0, 1.0, 2.0]


def test_of_requests_that_wait_the_newest_of_each_kind_is_served_and_all_are_answered(served: Served):
    with served.link() as link:
        link.recv(5)
        StandIn.may.clear()
        for number in range(20):
            link.send(json.dumps({"op": "show", "id": number, "slot": number % 2}))
            # the first one is under way
            time.sleep(0.01 if number else 0.2)
        time.sleep(0.2)
        StandIn.may.set()
        ids, outdated = [], []
        for _ in range(20):
            answer = link.recv(5)
            if isinstance(answer, bytes):
                ids.append(head(answer)["id"])
            else:
                outdated.append(json.loads(answer)["id"])
                assert json.loads(answer)["outdated"]
    # what was under way, and the last of both
    assert ids[0] == 0 and sorted(ids[1:]) == [18, 19] and sorted(outdated) == list(range(1, 18))


def test_a_second_recording_is_refused_at_once_while_the_first_is_made(served: Served):
    with served.link() as link:
        link.recv(5)
        StandIn.may.clear()
        for number in (1, 2):
            link.send(json.dumps({"op": "record", "id": number, "state": {}}))
        answer = json.loads(link.recv(5))
        assert answer["id"] == 2 and answer["refused"].startswith("a run of this page is being recorded")


def test_a_request_beyond_those_that_may_wait_is_refused(served: Served):
    with served.link() as link:
        link.recv(5)
        StandIn.may.clear()
        for number in range(MAX_WAITING + 2):
            link.send(json.dumps({"op": "show", "id": number, "slot": number}))
            # the first one is under way
            time.sleep(0.0 if number else 0.2)
        answer = json.loads(link.recv(5))
        assert answer["id"] == MAX_WAITING + 1 and "are waiting" in answer["refused"]


def test_a_crash_is_a_sentence_and_the_page_goes_on(served: Served):
    with served.link() as link:
        link.recv(5)
        link.send(json.dumps({"op": "save", "id": 1}))
        assert json.loads(link.recv(5))["failed"] == "drive.fmu crashed"
        link.send(json.dumps({"op": "show", "id": 2}))
        assert isinstance(link.recv(5), bytes)


@pytest.mark.parametrize("text", ["{", "[]", '{"op": 1}', "[" * 20000, '"x"', '{"op": "begin", "settings": []}'])
def test_what_is_no_request_starts_nothing(served: Served, text: str):
    with served.link() as link:
        link.recv(5)
        link.send(text)
        link.send(json.dumps({"op": "show", "id": 2}))
        while isinstance(link.recv(5), str):
            pass
    assert [ask["op"] for ask in StandIn.asked] == ["begin", "show"]


def test_a_message_that_is_too_large_ends_the_link_only(served: Served):
    with served.link() as link:
        link.recv(5)
        link.send("x" * 100_000)
        with pytest.raises(ConnectionClosed):
            link.recv(5)
    with served.link() as link:
        assert json.loads(link.recv(5))["op"] == "begin"


def test_it_ends_when_the_last_page_was_closed_for_a_while_and_not_before(served: Served):
    with served.link():
        with served.link() as second:
            second.recv(5)
        time.sleep(2 * LINGER)
        assert served.thread.is_alive()
    # one that is loaded anew comes back in time
    time.sleep(0.3 * LINGER)
    with served.link():
        time.sleep(2 * LINGER)
        assert served.thread.is_alive()
    served.thread.join(10)
    assert not served.thread.is_alive()


def test_an_experiment_that_is_refused_is_so_before_anything_listens(monkeypatch: pytest.MonkeyPatch):
    monkeypatch.setattr(explorer, "AnsweringProcess", StandIn)
    with pytest.raises(InputRefused, match="no such experiment"):
        ExplorerServer({"experiment": "x"}, JobLimits(), LINGER).begin(["a=1"])


def test_a_server_that_is_started_anew_knows_its_pages_again_and_others_do_not(
    tmp_path: Any, monkeypatch: pytest.MonkeyPatch
):
    monkeypatch.setenv("TWIN_CACHE", str(tmp_path / "cache"))
    token = lasting_token(1234)
    assert len(token) >= 32 and lasting_token(1234) == token != lasting_token(1235)
    (file,) = (tmp_path / "cache").rglob("1234.token")
    assert file.stat().st_mode & 0o077 == 0


def test_a_page_that_is_closed_sets_no_process_free_that_is_still_at_work(served: Served):
    StandIn.may.clear()
    for number in range(2):
        with served.link() as link:
            link.recv(5)
            link.send(json.dumps({"op": "show", "id": number}))
            time.sleep(0.2)
    with served.link() as link:
        link.recv(5)
        link.send(json.dumps({"op": "show", "id": 7}))
        with pytest.raises(TimeoutError):
            link.recv(0.3)
        StandIn.may.set()
        assert isinstance(link.recv(5), bytes)


def test_a_picture_waits_for_no_loops_and_no_scorecard_of_any_page(served: Served, monkeypatch: pytest.MonkeyPatch):
    monkeypatch.setattr(StandIn, "prompt", ("show",))
    with served.link() as one, served.link() as other:
        for link in (one, other):
            link.recv(5)
        StandIn.may.clear()
        for link in (one, other):
            for op in ("loops", "score"):
                link.send(json.dumps({"op": op, "id": 1, "state": {}}))
        time.sleep(0.2)
        # of the four one is under way
        assert len([ask for ask in StandIn.asked if ask["op"] != "begin"]) == 1
        other.send(json.dumps({"op": "show", "id": 2}))
        assert head(other.recv(5))["id"] == 2
        StandIn.may.set()
        for link in (one, other):
            assert {head(link.recv(5))["op"] for _ in range(2)} == {"loops", "score"}


class OneSession:
    """In place of a `LiveSession`: a proposal, until it is accepted."""

    def __init__(self) -> None:
        self.version, self.pressed, self.accepted = 0, list[object](), list[dict[str, Any]]()

    async def attend(self) -> None:
        pass

    def to_dict(self) -> dict[str, Any]:
        return {"proposal": "k_s", "block": ""}

    async def accept(self, proposal: object) -> str:
        self.pressed.append(proposal)
        if proposal != "k_s":
            return "twin does not propose that any more"
        self.accepted = [{"text": "k_s"}]
        return ""


@pytest.fixture
def beside(monkeypatch: pytest.MonkeyPatch) -> Iterator[tuple[Served, OneSession]]:
    monkeypatch.setattr(explorer, "AnsweringProcess", StandIn)
    session = OneSession()
    found = Served(session)
    yield found, session
    found.end()


def heard(link: ClientConnection, op: str) -> dict[str, Any]:
    """The next answer of one kind."""
    while True:
        answer = link.recv(5)
        if isinstance(answer, bytes):
            answer = answer[4 : 4 + struct.unpack_from("<I", answer)[0]]
        found: dict[str, Any] = json.loads(answer)
        if found["op"] == op:
            return found


def test_a_page_of_its_own_accepts_what_it_has_shown_and_takes_over_what_was_accepted(
    beside: tuple[Served, OneSession],
):
    served, session = beside
    with served.link() as link:
        assert heard(link, "robot")["proposal"] == "k_s"
        link.send(json.dumps({"op": "adopt", "id": 1, "state": {}}))
        assert heard(link, "adopt")["refused"] == "nothing was accepted in this session"
        link.send(json.dumps({"op": "accept", "id": 2, "proposal": "zero"}))
        assert heard(link, "accept")["refused"] == "twin does not propose that any more"
        # while an experiment takes long
        StandIn.may.clear()
        link.send(json.dumps({"op": "show", "id": 3}))
        link.send(json.dumps({"op": "accept", "id": 4, "proposal": "k_s"}))
        assert heard(link, "accept") == {"op": "accept", "id": 4, "slot": None}
        StandIn.may.set()
        # what was accepted is the session's to say, not the page's
        link.send(json.dumps({"op": "adopt", "id": 5, "state": {}, "accepted": [{"text": "mine"}]}))
        heard(link, "adopt")
    assert session.pressed == ["zero", "k_s"]
    assert [ask["accepted"] for ask in StandIn.asked if ask["op"] == "adopt"] == [[{"text": "k_s"}]]


@pytest.mark.parametrize(
    "headers",
    [
        {"Origin": "http://evil.example"},
        {"Origin": "http://127.0.0.1:1"},
        {"Origin": "null"},
        {"Host": "evil.example"},
        {"Cookie": "a=b"},
        {"Sec-Fetch-Site": "cross-site"},
    ],
)
def test_no_page_of_another_site_sees_the_robot_or_accepts_anything(
    beside: tuple[Served, OneSession], headers: dict[str, str]
):
    served, session = beside
    with pytest.raises((InvalidStatus, ConnectionClosed)), served.link(**headers) as link:
        link.send(json.dumps({"op": "accept", "proposal": "k_s"}))
        link.recv(5)
    given = {"Cookie": served.cookie, "Origin": served.origin} | {"Origin": "http://evil.example"}
    assert served.get("/accept", "POST", **given).status == 403
    assert session.pressed == []


def test_without_a_session_there_is_nothing_to_accept(served: Served):
    with served.link() as link:
        link.send(json.dumps({"op": "accept", "id": 1, "proposal": "k_s"}))
        assert heard(link, "accept")["refused"] == "--follow: twin explore was started without a session"
