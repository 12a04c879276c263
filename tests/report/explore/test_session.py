"""The explorer beside a session: what is shown of it, what is accepted, and what is not."""

import asyncio
import base64
import http.server
import json
import math
import re
import socketserver
import threading
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from websockets.sync.server import ServerConnection, serve

from tests.robot.live.viewer import address_in
from tests.studies.shadow.live_sessions import ROBOT, SPRING, SoftRobot
from tests.studies.shadow.test_live_view import TOPICS, OneProposal
from twin.kernel.errors import InputRefused
from twin.kernel.gate import Gate, viewer_policy
from twin.report.explore import session as module
from twin.report.explore.session import STRIP_SAMPLES, STRIP_STEP, ForceStrip, LiveSession
from twin.robot.assembly.load import load_experiment
from twin.robot.live.server import Broadcast, LiveServer
from twin.studies.replay.parts import Happening
from twin.studies.shadow import LINE_PARAMETER, PROPOSAL_PARAMETER
from twin.studies.shadow.live_view import ShadowViewer

LATEST = 30.0
"""s, on a machine that is busy."""


@pytest.fixture(autouse=True)
def impatient(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(module, "RETRY_INTERVAL", 0.05)


class Listening:
    """A `LiveSession` in a loop of its own."""

    def __init__(self, address: str):
        self.session = LiveSession(address)
        self._loop = asyncio.new_event_loop()
        self._thread = threading.Thread(target=self._loop.run_forever, daemon=True)
        self._thread.start()
        self._task = asyncio.run_coroutine_threadsafe(self.session.attend(), self._loop)

    def close(self) -> None:
        self._task.cancel()
        # what was cancelled has to end
        asyncio.run_coroutine_threadsafe(asyncio.sleep(0.1), self._loop).result(10)
        self._loop.call_soon_threadsafe(self._loop.stop)
        self._thread.join(10)
        self._loop.close()

    def until(self, condition: Callable[[dict[str, Any]], object]) -> dict[str, Any]:
        """What a page is shown as soon as `condition` holds."""

        async def wait() -> dict[str, Any]:
            async with asyncio.timeout(LATEST):
                while not condition(facts := self.session.to_dict()):
                    await asyncio.sleep(0.01)
                return facts

        return asyncio.run_coroutine_threadsafe(wait(), self._loop).result(2 * LATEST)

    def accept(self, proposal: object) -> str:
        return asyncio.run_coroutine_threadsafe(self.session.accept(proposal), self._loop).result(LATEST)


@contextmanager
def listening(address: str) -> Iterator[Listening]:
    found = Listening(address)
    yield found
    found.close()


@contextmanager
def shown(twin: Any, port: int = 0) -> Iterator[tuple[str, ShadowViewer]]:
    """(address, viewer) of a session with a twin that proposes."""
    told = list[str]()
    with LiveServer(port, told.append, waits=False) as server:
        viewer = ShadowViewer(server, TOPICS, load_experiment(ROBOT), twin)
        yield address_in(told[0]), viewer


def subscribed(viewer: ShadowViewer) -> bool:
    on_air = viewer._server._active
    return bool(on_air and on_air[0].wanted)


def forces(facts: dict[str, Any]) -> dict[str, np.ndarray]:
    """Samples of the strip, by the names of the curves."""
    values = np.frombuffer(base64.b64decode(facts["block"]), "<f4").reshape(-1, facts["count"])
    return dict(zip(facts["curves"], values, strict=True))


def test_a_proposal_is_shown_and_accepted_only_as_it_was_shown():
    twin = OneProposal()
    first, text = twin.proposal, str(twin.proposal)
    with shown(twin) as (address, viewer), listening(address) as explorer:
        viewer.say("12.3 s  500 Hz")
        facts = explorer.until(lambda facts: facts["line"])
        assert (facts["watches"], facts["proposal"]) == ("", text)
        explorer.until(lambda _: subscribed(viewer))
        rows = {name: np.full((1, sum(port.size for port in ports)), 1.0) for name, ports in TOPICS.items()}
        viewer.show(np.array([12_300_000_000]), rows, [Happening(12.3, "robot and twin diverge")])
        facts = explorer.until(lambda facts: facts["events"] and len(facts["curves"]) == 2)
        assert facts["events"] == ["12.3 s  robot and twin diverge"]
        newest = {name: curve[-1] for name, curve in forces(facts).items()}
        assert newest == {"robot, by its counts": -1.0, "twin": -1.0}
        # what the page shows is not what is open by now
        twin.proposal = None
        viewer.show(np.array([], dtype=np.int64), {}, [])
        explorer.until(lambda facts: not facts["proposal"])
        assert explorer.accept(text) == "Not accepted: twin does not propose that any more."
        twin.proposal = first
        viewer.show(np.array([], dtype=np.int64), {}, [])
        explorer.until(lambda facts: facts["proposal"])
        assert explorer.accept(text) == ""
        assert explorer.until(lambda facts: facts["asked"])["accepted"] == [] == twin.adaptations
        viewer.press()
        facts = explorer.until(lambda facts: facts["accepted"])
        assert (facts["accepted"], facts["proposal"], facts["asked"]) == ([text], "", False)
        assert twin.adaptations == [first]
        assert explorer.session.accepted == [{"text": text, "field": "k_s_share", "leg": 1, "value": 0.93}]


@pytest.mark.parametrize(
    ("query", "sentence"),
    [("", "--follow has no token"), ("?token=wrong", "the token of --follow is not that of this")],
)
def test_without_the_token_of_the_session_it_watches_and_says_so(query: str, sentence: str):
    twin = OneProposal()
    with shown(twin) as (address, viewer), listening(address.partition("?")[0] + query) as explorer:
        facts = explorer.until(lambda facts: not facts["problem"])
        assert facts["watches"].startswith(f"Watching only: {sentence}") and facts["proposal"]
        assert explorer.accept(facts["proposal"]) == facts["watches"]
        assert viewer.press() == "" and twin.adaptations == []


def test_what_has_ended_or_is_not_there_yet_is_said_and_found_again():
    twin = OneProposal()
    with shown(twin) as (address, _), listening(address) as explorer:
        port = int(re.findall(r":(\d+)/", address)[0])
        explorer.until(lambda facts: facts["proposal"] and not facts["problem"])
    with listening(address) as explorer:
        facts = explorer.until(lambda facts: not facts["problem"].startswith("Connecting"))
        assert (
            facts["problem"]
            == f"Nothing answers at ws://127.0.0.1:{port}: start twin shadow with --live. Trying again."
        )
        assert explorer.accept(str(twin.proposal)) == facts["problem"]
        with shown(twin, port):
            # with another token
            explorer.until(lambda facts: facts["watches"] and not facts["problem"])
        lost = explorer.until(lambda facts: "is lost" in facts["problem"] or "Nothing answers" in facts["problem"])
        # what was known stays to be seen
        assert lost["proposal"] == str(twin.proposal)


class Gains:
    """Parameters of a run."""

    def values(self) -> dict[str, bool | float | str]:
        return {"controller.position.kp_per_s": 1.5}

    def request(self, name: str, value: object, /) -> None:
        raise AssertionError


def test_a_run_is_named_and_not_begun():
    gate = Gate(viewer_policy())
    broadcast = Broadcast(0, gate, (), Gains())
    try:
        with listening(f"ws://localhost:{broadcast.port}/?token={gate.token}") as explorer:
            facts = explorer.until(lambda facts: "serves a run (twin run --live)" in facts["problem"])
            assert "expected twin shadow --live" in facts["problem"]
            assert broadcast.news.empty()
    finally:
        broadcast.close()


def silent(link: ServerConnection) -> None:
    link.recv()


def garbled(link: ServerConnection) -> None:
    link.send('{"op": "serverInfo", "name": "twin"}')
    link.send('{"op": "parameterValues", "parameters": 7}')
    silent(link)


def other(link: ServerConnection) -> None:
    link.send('{"op": "serverInfo", "name": "foxglove_bridge"}')
    silent(link)


def mute(link: ServerConnection) -> None:
    values = [{"name": name, "value": "k_s"} for name in (LINE_PARAMETER, PROPOSAL_PARAMETER)]
    link.send('{"op": "serverInfo", "name": "twin"}')
    link.send(json.dumps({"op": "parameterValues", "parameters": values, "id": "all"}))
    while True:
        link.recv()


def test_a_twin_that_does_not_answer_is_waited_for_no_longer_than_a_moment(monkeypatch: pytest.MonkeyPatch):
    monkeypatch.setattr(module, "ANSWER_TIMEOUT", 0.3)
    with serve(mute, "127.0.0.1", 0) as server:
        threading.Thread(target=server.serve_forever, daemon=True).start()
        name = f"ws://127.0.0.1:{server.socket.getsockname()[1]}"
        with listening(f"{name}/?token=t") as explorer:
            explorer.until(lambda facts: not facts["problem"])
            assert explorer.accept("k_s") == f"{name} does not answer."


STRANGER = "is not a live server of twin; expected twin shadow --live"


@pytest.mark.parametrize(
    ("attend", "sentence"), [(silent, "does not answer: twin shadow hangs"), (garbled, STRANGER), (other, STRANGER)]
)
def test_a_server_of_others_is_named_and_holds_nothing_up(
    attend: Callable[[ServerConnection], None], sentence: str, monkeypatch: pytest.MonkeyPatch
):
    monkeypatch.setattr(module, "ANSWER_TIMEOUT", 0.3)
    with serve(attend, "127.0.0.1", 0) as server:
        threading.Thread(target=server.serve_forever, daemon=True).start()
        with listening(f"ws://127.0.0.1:{server.socket.getsockname()[1]}") as explorer:
            facts = explorer.until(lambda facts: not facts["problem"].startswith("Connecting"))
            assert sentence in facts["problem"]


def test_a_page_server_in_its_place_is_named():
    with socketserver.TCPServer(("127.0.0.1", 0), http.server.BaseHTTPRequestHandler) as server:
        threading.Thread(target=server.serve_forever, daemon=True).start()
        with listening(f"ws://127.0.0.1:{server.server_address[1]}") as explorer:
            explorer.until(lambda facts: "refuses" in facts["problem"] or "is not a live server" in facts["problem"])
        server.shutdown()


@pytest.mark.parametrize(
    "address",
    ["8765", "http://127.0.0.1:8765", "ws://10.0.0.1:8765/?token=secret", "ws://localhost:99999", "ws://localhost"],
)
def test_what_is_no_address_of_this_machine_is_refused_without_its_token(address: str):
    with pytest.raises(InputRefused, match="expected the address that twin shadow --live has printed") as refused:
        LiveSession(address)
    assert "secret" not in str(refused.value)


def test_the_strip_holds_each_sample_until_the_next_one_and_has_gaps():
    strip = ForceStrip()
    for t, force in ((100.0, 9.0), (200.0, 1.0), (200.5, 2.0), (203.0, 3.0)):
        strip.add("/plant", t, force)
    strip.add("/scale", 203.0, math.nan)
    facts = strip.to_dict()
    assert facts["curves"] == ["twin"]
    (curve,) = forces(facts).values()
    assert len(curve) == STRIP_SAMPLES and curve[-1] == 3.0
    at = STRIP_SAMPLES - 1 - round(3.0 / STRIP_STEP)
    half = round(0.5 / STRIP_STEP)
    assert np.all(np.isnan(curve[:at])) and np.all(curve[at : at + half] == 1.0) and curve[at + half] == 2.0
    # after that nothing came for 2.5 s
    assert np.all(np.isnan(curve[at + half + 1 : -1]))


@pytest.mark.slow
def test_beside_a_robot_whose_spring_has_softened_the_proposal_is_accepted_and_recorded(tmp_path: Path):
    with SoftRobot(tmp_path, speed=0.0) as robot, listening(robot.address) as explorer:
        facts = explorer.until(lambda facts: facts["proposal"])
        assert facts["proposal"].startswith("k_s of joint 2 was 1.0") and facts["watches"] == ""
        assert explorer.accept(facts["proposal"]) == ""
        facts = explorer.until(lambda facts: facts["accepted"] and len(facts["curves"]) == 3)
        (spring,) = explorer.session.accepted
        assert (spring["field"], spring["leg"]) == ("k_s_share", 1) and abs(spring["value"] - SPRING) < 0.01
        assert "500 Hz" in facts["line"]
        events = [event.text for event in robot.end().events]
    assert f"accepted: {spring['text']}" in events
