"""The server by itself: ports, a missing package, one run after another."""

import socket
import sys
import threading
from pathlib import Path

import pytest

from tests.laws.runs import shipped
from tests.robot.live.viewer import Viewer
from twin.kernel.errors import InputRefused
from twin.kernel.process.reporter import DirectReporter
from twin.robot.live.runs import served_runs
from twin.robot.live.server import LiveServer
from twin.robot.run.run import execute

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

    def watch(address: str) -> None:
        addresses.append(address)
        viewers.append(Viewer(address))
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
