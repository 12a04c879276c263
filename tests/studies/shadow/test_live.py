"""`twin shadow` beside a robot in another process, over DDS on the loopback."""

import json
import signal
import socket
import sys
import time
from pathlib import Path
from subprocess import Popen

import pytest

from tests.conftest import ROOT
from tests.robot.live.viewer import Viewer
from tests.studies.replay.logs import FIG4
from tests.studies.shadow.conftest import Start
from tests.studies.shadow.test_live_view import ADDRESS
from tests.studies.shadow.test_study import MAP
from twin.kernel.recording.reader import read

PUBLISHER = Path(__file__).with_name("publisher.py")
MAPS = [word for one in MAP for word in ("--map", one)]
SHADOW = [sys.executable, "-m", "twin", "shadow", FIG4, *MAPS]
LIVE = ["--source", "ros2:/joint_states"]


def ended(one: Popen[str], seconds: float = 120.0) -> tuple[int, str, str]:
    out, err = one.communicate(timeout=seconds)
    return one.returncode, out, err


def published(start: Start, angles: Path, domain: int, rate: float, seconds: float, *options: object) -> Popen[str]:
    return start(sys.executable, PUBLISHER, angles, rate, seconds, "--domain", domain, *options)


def test_a_robot_is_followed_to_its_last_sample_and_recorded_as_it_came_whatever_viewers_do(
    start: Start, angles: Path, domain: int, tmp_path: Path
):
    robot = published(start, angles, domain, 1000, 2.5, "--best-effort", "--pause", "4")
    twin = start(*SHADOW, *LIVE, "--live", "--port", "0", "--duration-s", "6.495", "--json", "--out", tmp_path / "out")
    assert twin.stderr is not None
    address = ADDRESS.fullmatch(twin.stderr.readline())
    assert address
    with Viewer(address[1]) as silent, Viewer(address[1]) as leaving:
        # one that never reads, and one that goes without a word
        for viewer in (silent, leaving):
            viewer.until(lambda viewer=viewer: "/events" in viewer.channels)  # type: ignore[misc]
            viewer.subscribe(*viewer.channels)
        leaving.until(lambda: bool(leaving.messages("/plant")))
        leaving.socket.socket.shutdown(socket.SHUT_RDWR)
        code, out, err = ended(twin)
    assert code == 0, err
    facts = json.loads(out)
    counts = facts["counts"]
    # the robot was silent once, and said no less
    assert (counts["gaps"], counts["missing"]) == (1, 4000), (counts, err)
    assert counts["samples"] in range(2496, 2501)
    assert facts["period_s"] == pytest.approx(1e-3)
    assert abs(facts["clock_offset_s"]) < 1.0
    assert "no sample for 2 s: nothing has come of /joint_states, which has 1 publisher" in err
    assert ended(robot)[0] == 0
    recording = read(tmp_path / "out")
    assert recording.complete and len(recording["estimator.p_B"]) == counts["samples"]


@pytest.mark.slow
def test_a_topic_that_nobody_publishes_is_waited_for_with_what_is_there(
    start: Start, angles: Path, domain: int, tmp_path: Path
):
    published(start, angles, domain, 100, 1, "--topic", "/joint_state")
    twin = start(*SHADOW, *LIVE, "--out", tmp_path / "out")
    told = ""
    assert twin.stderr is not None
    while "did you mean" not in told:
        told += twin.stderr.readline()
        assert twin.poll() is None, told
    assert told.endswith("waiting for /joint_states; did you mean '/joint_state'?\n")
    assert not (tmp_path / "out").exists()


@pytest.mark.slow
def test_after_a_kill_the_recording_is_readable_to_the_last_second(
    start: Start, angles: Path, domain: int, tmp_path: Path
):
    published(start, angles, domain, 500, 30)
    twin = start(*SHADOW, *LIVE, "--out", tmp_path / "out")
    partial = tmp_path / "out" / "run.mcap.partial"
    limit = time.monotonic() + 40.0
    while time.monotonic() < limit and not partial.is_file():
        time.sleep(0.05)
    began = time.monotonic()
    time.sleep(2.5)
    twin.kill()
    lived = time.monotonic() - began
    recording = read(partial)
    assert "unfinished" in recording.note
    assert recording.time("estimator")[-1] > lived - 1.0 - 0.5


@pytest.mark.slow
def test_ctrl_c_ends_a_session_with_its_summary(start: Start, angles: Path, domain: int, tmp_path: Path):
    published(start, angles, domain, 500, 30)
    twin = start(*SHADOW, *LIVE, "--out", tmp_path / "out")
    while not (tmp_path / "out" / "run.mcap.partial").is_file():
        time.sleep(0.05)
        assert twin.poll() is None
    time.sleep(0.5)
    twin.send_signal(signal.SIGINT)
    code, out, _ = ended(twin)
    assert code == 0 and "ended by hand" in out
    assert read(tmp_path / "out").complete


@pytest.mark.slow
def test_another_type_than_the_map_means_is_refused_in_a_sentence(
    start: Start, angles: Path, domain: int, tmp_path: Path
):
    published(start, angles, domain, 500, 10)
    maps = [word.replace(".position.", ".wrench.") for word in MAPS]
    twin = start(sys.executable, "-m", "twin", "shadow", FIG4, *maps, *LIVE, "--out", tmp_path / "out")
    code, _, err = ended(twin)
    assert code == 2
    assert "/joint_states has no number 'wrench.m1' for estimator.theta_m[0]; it has header, name, position" in err


STALLED = """
import sys, time
from twin.kernel.recording.sources.dds import DdsSource
source = DdsSource("ros2:/joint_states")
while "/joint_states" not in source.topic_types():
    time.sleep(0.01)
source.subscribe("/joint_states")
stamps, n = set(), int(sys.argv[1])
until = time.monotonic() + 30
while len(stamps) < n and time.monotonic() < until:
    {stall}
    stamps.update(one.data[4:12] for one in source.receive(0.1))
print(len(stamps), source.drop_count)
source.close()
"""
HOLD = """
    # nothing else in this process gets a turn
    sys.setswitchinterval(0.5)
    end = time.monotonic() + 0.5
    while time.monotonic() < end:
        pass
    sys.setswitchinterval(0.005)
    time.sleep(0.1)"""


@pytest.mark.slow
def test_half_a_second_without_a_turn_at_a_thousand_a_second_loses_nothing(start: Start, angles: Path, domain: int):
    published(start, angles, domain, 1000, 3, "--best-effort")
    code, out, err = ended(start(sys.executable, "-c", STALLED.format(stall=HOLD), 3000))
    assert (code, out) == (0, "3000 0\n"), err


def test_nothing_is_ever_published_to_the_robot():
    sources = ROOT / "twin" / "kernel" / "recording" / "sources"
    text = "".join(file.read_text() for file in sources.glob("*.py"))
    assert not any(word in text for word in ("DataWriter", "cyclonedds.pub", "declare_publisher", ".put(data"))
