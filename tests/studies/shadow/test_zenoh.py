"""`twin shadow` beside a robot with the keys of rmw_zenoh, over eclipse-zenoh's router on the loopback."""

import json
import socket
import sys
from pathlib import Path

import pytest

from tests.studies.replay.logs import FIG4
from tests.studies.shadow.conftest import Start
from tests.studies.shadow.test_live import MAPS, ended
from twin.kernel.recording.reader import read

pytestmark = pytest.mark.slow
pytest.importorskip("zenoh")
SHADOW = [sys.executable, "-m", "twin", "shadow", FIG4, *MAPS, "--source", "zenoh:/joint_states"]


def free_port() -> int:
    with socket.socket() as one:
        one.bind(("127.0.0.1", 0))
        return int(one.getsockname()[1])


def configured(folder: Path, port: int) -> dict[str, str]:
    """Variables of a client of the router at that port."""
    file = folder / "session.json5"
    endpoint = {"endpoints": [f"tcp/127.0.0.1:{port}"]}
    file.write_text(json.dumps({"mode": "client", "connect": endpoint, "scouting": {"multicast": {"enabled": False}}}))
    return {"ZENOH_SESSION_CONFIG_URI": str(file), "ROS_DOMAIN_ID": "0"}


def test_a_robot_behind_a_router_is_followed_without_a_loss(start: Start, angles: Path, tmp_path: Path):
    port = free_port()
    robot = start(sys.executable, Path(__file__).with_name("zenoh_publisher.py"), angles, port, 500, 4)
    assert robot.stdout is not None and robot.stdout.readline() == "ready\n"
    variables = configured(tmp_path, port)
    code, out, err = ended(start(*SHADOW, "--duration-s", "3.9", "--json", "--out", tmp_path / "out", **variables))
    assert code == 0, err
    counts = json.loads(out)["counts"]
    assert counts["samples"] >= 1950 and counts["missing"] == counts["late"] == 0
    assert read(tmp_path / "out").complete


def test_without_a_router_it_is_refused_in_a_sentence(start: Start, tmp_path: Path):
    variables = configured(tmp_path, free_port())
    code, _, err = ended(start(*SHADOW, "--out", tmp_path / "out", **variables))
    assert code == 2
    assert err.startswith("--source zenoh:/joint_states: no router as ZENOH_SESSION_CONFIG_URI=")
    assert len(err.strip().splitlines()) == 1
