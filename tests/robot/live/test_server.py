"""The server by itself: ports, a missing package, one run after another."""

import socket
import sys
import threading
from pathlib import Path

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from tests.laws.runs import shipped
from tests.robot.live.viewer import Viewer, address_in
from twin.kernel.errors import InputRefused
from twin.kernel.process.reporter import DirectReporter
from twin.kernel.recording.messages import HEAD_SIZE, Field, Topic, message_layout
from twin.kernel.recording.recorder import RowStream
from twin.robot.live.runs import served_runs
from twin.robot.live.server import LiveServer
from twin.robot.live.topics import MessageEncoder
from twin.robot.run.run import execute

TOPICS = (
    Topic("a", (Field("x", 3, "double", "m", ""), Field("n", 2, "int", "1", ""), Field("on", 1, "bool", "1", "")), 1),
    Topic(
        "b/1", (Field("on", 2, "bool", "1", ""), Field("J", 20, "double", "m", ""), Field("n", 1, "int", "1", "")), 2
    ),
)
STREAMS = (RowStream(TOPICS[0], slice(0, 6)), RowStream(TOPICS[1], slice(6, 29)))
WHOLE = (3, 4, 28)
"""Columns that hold whole numbers."""


@given(st.lists(st.floats(allow_nan=False, allow_infinity=False, width=32), min_size=29, max_size=29))
def test_a_published_message_has_the_bytes_of_the_recorded_one(numbers: list[float]):
    row = np.array(numbers)
    row[list(WHOLE)] = np.clip(np.rint(row[list(WHOLE)]), -(2.0**62), 2.0**62)
    encoder = MessageEncoder(STREAMS)
    # twice, because what was there before must not shine through
    list(encoder.messages(np.ones(29)))
    for stream, message in zip(STREAMS, encoder.messages(row), strict=True):
        layout = message_layout(7, stream.topic.fields)
        records = layout.filling.records(np.zeros(1, dtype=int), 0, row[None, stream.columns])
        assert message == records[0, HEAD_SIZE:].tobytes()


SILENT = DirectReporter(lambda note: None)


def test_a_port_that_is_taken_is_refused_in_one_sentence_before_anything_runs():
    with socket.create_server(("127.0.0.1", 0)) as other:
        port = other.getsockname()[1]
        with pytest.raises(InputRefused, match=f"--port {port}: .*in use.*; choose another one, or 0") as refused:
            LiveServer(port, lambda address: None)
    assert refused.value.exit_code == 2
    assert "\n" not in str(refused.value)


def test_without_websockets_the_sentence_says_what_to_install(monkeypatch: pytest.MonkeyPatch):
    for name in [name for name in sys.modules if name.startswith(("websockets.", "twin.robot.live."))]:
        monkeypatch.delitem(sys.modules, name)
    monkeypatch.setitem(sys.modules, "websockets", None)
    with pytest.raises(InputRefused, match=r"websockets is not installed; pip install 'websockets>="):
        served_runs(SILENT, 0, [])


def test_runs_follow_one_another_at_one_address_and_each_waits_for_a_viewer(tmp_path: Path):
    addresses: list[str] = []
    viewers: list[Viewer] = []
    watching: list[threading.Thread] = []

    def watch(text: str) -> None:
        addresses.append(address_in(text))
        viewers.append(Viewer(addresses[-1]))
        watching.append(threading.Thread(target=_see_plant, args=(viewers[-1],)))
        watching[-1].start()

    with LiveServer(0, watch) as server:
        for number in (1, 2):
            (tmp_path / str(number)).mkdir()
            execute(shipped("fig4_position", "duration_s=1"), tmp_path / str(number), factor=4, viewer=server)
    for thread in watching:
        thread.join()
    assert len(addresses) == 2
    assert len(set(addresses)) == 1
    for viewer in viewers:
        times = [each.time for each in viewer.messages("/plant")]
        assert times[0] == 0
        assert times[-1] == 1_000_000_000


def _see_plant(viewer: Viewer) -> None:
    with viewer:
        viewer.subscribe("/plant")
        viewer.to_the_end()
