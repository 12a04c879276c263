"""The server by itself, without a run: slow viewers, many viewers, viewers of another time."""

import time
from collections.abc import Iterator
from functools import partial
from pathlib import Path

import pytest
from foxglove_schemas_protobuf.Log_pb2 import Log
from websockets.exceptions import InvalidStatus

from tests.runs.live.viewer import Viewer
from twin.recording.schema import log_descriptor_set
from twin.runs.assembly.assemble import assemble
from twin.runs.assembly.load import load_experiment
from twin.runs.live import broadcast as on_air
from twin.runs.live.broadcast import Broadcast
from twin.runs.live.client import BACKLOG
from twin.runs.live.gate import Gate
from twin.runs.live.protocol import Channel, Message
from twin.runs.tuning import Tuning

CHANNEL = Channel(1, "/words", "foxglove.Log", log_descriptor_set(), {})
LARGE = 2**14
"""Bytes of a message that is sent: thousands of them fill every buffer of the operating system."""


@pytest.fixture
def address(served: Broadcast) -> str:
    return f"ws://127.0.0.1:{served.port}/"


@pytest.fixture
def served(root: Path) -> Iterator[Broadcast]:
    experiment = load_experiment(root / "experiments" / "fig4_position.toml")
    with assemble(experiment) as assembly:
        broadcast = Broadcast(0, Gate(), [CHANNEL], Tuning(experiment, assembly))
        yield broadcast
        broadcast.close()


@pytest.mark.parametrize("name", ["foxglove.sdk.v1", "foxglove.websocket.v1"])
def test_both_names_of_the_protocol_are_understood(address: str, name: str):
    with Viewer(address, subprotocol=name) as viewer:
        assert viewer.socket.subprotocol == name
        viewer.until(lambda: "/words" in viewer.channels)


def test_another_protocol_is_refused(address: str):
    with pytest.raises(InvalidStatus) as refused, Viewer(address, subprotocol="chat"):
        pass
    assert refused.value.response.status_code == 400


def test_a_viewer_that_does_not_read_loses_the_oldest_and_delays_nobody(served: Broadcast, address: str):
    with Viewer(address) as idle, Viewer(address) as quick:
        for viewer in (idle, quick):
            viewer.subscribe("/words")
        # answered after the subscription, so both are in force
        idle.parameters(), quick.parameters()
        number = 4 * BACKLOG
        content = Log(message="x" * LARGE).SerializeToString()
        began = time.monotonic()
        for moment in range(number):
            served.publish(moment, [Message(1, moment, content)])
            if moment % 64 == 0:
                quick.until(partial(_has_come_to, quick, moment))
        quick.until(partial(_has_come_to, quick, number - 1))
        assert time.monotonic() - began < 30.0
        assert len(quick.times) == number
        idle.until(partial(_has_come_to, idle, number - 1))
        assert BACKLOG / 2 <= len(idle.times) < number


def _has_come_to(viewer: Viewer, moment: int) -> bool:
    return viewer.times[-1:] == [moment]


def test_there_is_an_end_to_the_number_of_viewers(address: str, monkeypatch: pytest.MonkeyPatch):
    monkeypatch.setattr(on_air, "VIEWERS", 1)
    with Viewer(address) as first:
        first.until(lambda: bool(first.channels))
        with pytest.raises(InvalidStatus) as refused, Viewer(address):
            pass
    assert refused.value.response.status_code == 503


def test_what_a_viewer_asks_again_and_again_leaves_nothing_behind(served: Broadcast, address: str):
    with Viewer(address) as viewer:
        for _ in range(100):
            viewer.subscribe("/words")
            viewer.send(op="unsubscribe", subscriptionIds=[1])
            viewer.send(op="subscribeParameterUpdates", parameterNames=["nothing"])
        viewer.parameters()
        assert served.wanted == frozenset()
        assert served.newcomer.is_set()
    assert served.news.get() is None and served.news.empty()


def test_only_the_first_refusals_are_told(served: Broadcast, address: str):
    for number in range(3 + on_air.COMPLAINTS):
        for _ in range(2):
            with pytest.raises(InvalidStatus), Viewer(address, origin=f"http://evil.example:{number}"):
                pass
    assert served.news.qsize() == on_air.COMPLAINTS
