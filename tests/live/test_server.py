"""The server by itself: ports, a missing SDK, one run after another."""

import sys
import threading
from pathlib import Path

import pytest

from tests.laws.runs import shipped
from tests.live.viewer import Viewer
from twin.errors import InputRefused
from twin.execution import execute
from twin.guard.voice import DirectVoice
from twin.live.runs import served_runs
from twin.live.server import LiveServer

SILENT = DirectVoice(lambda note: None, lambda done, total: None)


def test_a_port_that_is_taken_is_refused_in_one_sentence():
    with LiveServer(0) as server:
        port = int(server.address.rpartition(":")[2])
        with pytest.raises(InputRefused, match=f"--port {port}: .*in use.*; choose another one, or 0") as refused:
            LiveServer(port)
    assert refused.value.exit_code == 2
    assert "\n" not in str(refused.value)


def test_only_this_machine_is_served():
    with LiveServer(0) as server:
        assert server.address.startswith("ws://127.0.0.1:")


def test_without_the_sdk_the_sentence_says_what_to_install(monkeypatch: pytest.MonkeyPatch):
    for name in [name for name in sys.modules if name.startswith(("foxglove.", "twin.live."))]:
        monkeypatch.delitem(sys.modules, name)
    monkeypatch.setitem(sys.modules, "foxglove", None)
    with pytest.raises(InputRefused, match=r"foxglove-sdk is not installed; pip install 'twin\[live\]'"):
        served_runs(SILENT, 0)


def test_runs_follow_one_another_on_one_server_each_from_time_0(tmp_path: Path):
    with LiveServer(0) as server:
        viewer = Viewer(server.address)

        def watch() -> None:
            with viewer:
                viewer.subscribe("/plant")
                first = viewer.channels["/plant"]["id"]
                viewer.until(lambda: viewer.channels["/plant"]["id"] != first)
                viewer.subscribe("/plant")
                viewer.to_the_end()

        thread = threading.Thread(target=watch)
        thread.start()
        for number in (1, 2):
            (tmp_path / str(number)).mkdir()
            execute(shipped("fig4_position", "duration_s=1"), tmp_path / str(number), factor=4, viewer=server)
    thread.join()
    times = [each.time for each in viewer.messages("/plant")]
    falls = [k for k in range(1, len(times)) if times[k] < times[k - 1]]
    assert len(falls) == 1
    assert times[falls[0] - 1] == times[-1] == 1_000_000_000
    sessions = {info["sessionId"] for info in viewer.of("serverInfo")}
    assert len(sessions) == 2
