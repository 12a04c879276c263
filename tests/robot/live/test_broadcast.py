"""The server by itself, without a run: slow viewers, many viewers, viewers of another time."""

import socket
import struct
import threading
from collections.abc import Iterator
from functools import partial
from pathlib import Path

import pytest
from foxglove_schemas_protobuf.Log_pb2 import Log
from websockets.exceptions import InvalidStatus

from tests.robot.live.viewer import Viewer
from twin.kernel.gate import Gate, viewer_policy
from twin.kernel.live import Channel, Message
from twin.kernel.recording.messages import descriptors_of
from twin.robot.assembly.assemble import assemble
from twin.robot.assembly.load import load_experiment
from twin.robot.live import server as on_air
from twin.robot.live.server import MAX_BACKLOG, Broadcast
from twin.robot.run.tuning import Tuning

CHANNEL = Channel(1, "/words", "foxglove.Log", descriptors_of(Log.DESCRIPTOR), {})
MOTTO = Channel(2, "/motto", "foxglove.Log", descriptors_of(Log.DESCRIPTOR), {}, constant=True)
WORD = Log(message="word").SerializeToString()
HANDSHAKE = b"""GET / HTTP/1.1\r
Host: localhost\r
Upgrade: websocket\r
Connection: Upgrade\r
Sec-WebSocket-Key: dGhlIHNhbXBsZSBub25jZQ==\r
Sec-WebSocket-Version: 13\r
Sec-WebSocket-Protocol: foxglove.sdk.v1\r
\r
"""
PING = b"\x89\x80\0\0\0\0"
ASKED = b'{"op":"subscribe","subscriptions":[{"id":1,"channelId":1}]}'
SUBSCRIBE = bytes([0x81, 0x80 | len(ASKED), 0, 0, 0, 0]) + ASKED
"""Frames of RFC 6455, 5.2, masked by 0."""
LARGE = 2**14
"""Bytes of a message that is sent: thousands of them fill every buffer of the operating system."""


@pytest.fixture
def address(served: Broadcast) -> str:
    return f"ws://127.0.0.1:{served.port}/"


@pytest.fixture
def served(root: Path, monkeypatch: pytest.MonkeyPatch) -> Iterator[Broadcast]:
    # pings would end a connection that is closing; when nobody has read for 20 s they wait like everything else
    monkeypatch.setattr(on_air, "serve", partial(on_air.serve, ping_interval=None))
    experiment = load_experiment(root / "experiments" / "fig4_position.toml")
    with assemble(experiment) as assembly:
        broadcast = Broadcast(0, Gate(viewer_policy()), [CHANNEL, MOTTO], Tuning(experiment, assembly))
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
        number = 4 * MAX_BACKLOG
        content = Log(message="x" * LARGE).SerializeToString()
        for moment in range(number):
            served.publish(moment, [Message(1, moment, content)])
            if moment % 64 == 0:
                quick.until(partial(_has_come_to, quick, moment))
        quick.until(partial(_has_come_to, quick, number - 1))
        assert len(quick.times) == number
        idle.until(partial(_has_come_to, idle, number - 1))
        assert MAX_BACKLOG / 2 <= len(idle.times) < number


def _has_come_to(viewer: Viewer, moment: int) -> bool:
    return viewer.times[-1:] == [moment]


@pytest.mark.slow
def test_a_broadcast_ends_though_a_viewer_does_not_read(served: Broadcast):
    # not one of ours, which would go when its pings are not answered: a tab that is stopped does nothing
    with socket.create_connection(("127.0.0.1", served.port)) as stopped:
        stopped.sendall(HANDSHAKE + SUBSCRIBE)
        assert served.news.get(timeout=60) is None
        content = Log(message="x" * LARGE).SerializeToString()
        for moment in range(4 * MAX_BACKLOG):
            served.publish(moment, [Message(1, moment, content)])
        assert _ends(served)


def test_a_broadcast_ends_though_somebody_connects_and_never_says_why(served: Broadcast):
    with socket.create_connection(("127.0.0.1", served.port)):
        assert _ends(served)


def _ends(served: Broadcast) -> bool:
    """Whether nothing of it is left soon after `close`."""
    closing = threading.Thread(target=served.close, daemon=True)
    closing.start()
    # far more than is promised, for a busy machine
    closing.join(10 * on_air.SHUTDOWN_TIMEOUT)
    served._thread.join(10 * on_air.SHUTDOWN_TIMEOUT)
    return not closing.is_alive() and not served._thread.is_alive()


def test_what_never_changes_comes_to_each_viewer_once(served: Broadcast, address: str):
    def publish(*channels: int) -> None:
        served.publish(0, [Message(channel, 0, WORD) for channel in channels])

    with Viewer(address) as first, Viewer(address) as second:
        first.subscribe("/words", "/motto")
        first.parameters()
        assert served.lacking == {2}
        publish(1, 2)
        first.until(lambda: len(first.messages("/words")) == 1)
        assert served.lacking == frozenset()
        second.subscribe("/motto", "/words")
        second.parameters()
        assert served.lacking == {2}
        # made when nobody asked for it: those who have it get it no more
        publish(1, 2)
        publish(1, 2)
        for viewer in (first, second):
            viewer.until(partial(_has_words, viewer, 3 if viewer is first else 2))
            assert len(viewer.messages("/motto")) == 1
        # who comes back has forgotten it
        second.send(op="unsubscribe", subscriptionIds=[2])
        second.subscribe("/motto")
        second.told.clear()
        second.parameters()
        publish(1, 2)
        second.until(partial(_has_words, second, 3))
        assert len(second.messages("/motto")) == 2


def _has_words(viewer: Viewer, number: int) -> bool:
    return len(viewer.messages("/words")) == number


def test_of_a_viewer_that_vanishes_nothing_is_told_in_the_terminal(
    served: Broadcast, address: str, caplog: pytest.LogCaptureFixture
):
    gone = threading.Event()
    with socket.create_connection(("127.0.0.1", served.port)) as viewer, Viewer(address) as other:
        viewer.sendall(HANDSHAKE)
        assert viewer.recv(1000).startswith(b"HTTP/1.1 101")
        # it vanishes before the server comes to its pings
        served._loop.call_soon_threadsafe(gone.wait, 60)
        viewer.sendall(20 * PING)
        # reset at once
        viewer.setsockopt(socket.SOL_SOCKET, socket.SO_LINGER, struct.pack("ii", 1, 0))
        viewer.close()
        gone.set()
        other.parameters()
    served.close()
    assert caplog.records == []


def test_there_is_an_end_to_the_number_of_viewers(address: str, monkeypatch: pytest.MonkeyPatch):
    monkeypatch.setattr(on_air, "MAX_VIEWERS", 1)
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
        assert served.wanted == served.lacking == frozenset()
    assert served.news.get() is None and served.news.empty()


def test_only_the_first_refusals_are_told(served: Broadcast, address: str):
    for number in range(3 + on_air.MAX_REFUSALS):
        for _ in range(2):
            with pytest.raises(InvalidStatus), Viewer(address, origin=f"http://evil.example:{number}"):
                pass
    assert served.news.qsize() == on_air.MAX_REFUSALS
