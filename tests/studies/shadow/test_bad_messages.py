"""`twin shadow` beside a played robot whose messages have faults."""

import json
import sys
import time
import tomllib
from pathlib import Path
from subprocess import Popen

import numpy as np
import pytest

from tests.conftest import ROOT
from tests.studies.replay.logs import FIG4, ran
from tests.studies.shadow.conftest import Start
from tests.studies.shadow.test_live import ended
from twin.kernel.recording.reader import read

PLAYER = Path(__file__).with_name("player.py")
MAPS = [
    word
    for signal, column in tomllib.loads((ROOT / "examples" / "served_robot.toml").read_text()).items()
    if not signal.startswith(("scale", "drive"))
    for word in ("--map", f"{signal}={column}")
]
"""The player has neither a scale nor torques."""
pytestmark = pytest.mark.slow


def played(folder: Path, *settings: str) -> Path:
    """Angles and commands of a run, as the player takes them."""
    run, path = ran(FIG4, *settings), folder / "run.npy"
    np.save(path, np.hstack([run[f"estimator.theta_{side}"] for side in "ml"] + [run["controller.omega_ref"]]))
    return path


@pytest.fixture(scope="session")
def robot(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A healthy run."""
    return played(tmp_path_factory.mktemp("played"))


def moving(start: Start, robot: Path, domain: int, seconds: float, *options: str) -> Popen[str]:
    """The player with those options."""
    return start(sys.executable, PLAYER, robot, "--domain", domain, "--seconds", seconds, *options)


def twin_of(start: Start, seconds: float, out: Path) -> Popen[str]:
    """A session of so many seconds."""
    words = [sys.executable, "-m", "twin", "shadow", FIG4, "--source", "ros2:/joint_states"]
    return start(*words, *MAPS, "--duration-s", seconds, "--json", "--out", out)


def beside(start: Start, robot: Path, domain: int, out: Path, *options: str, seconds: float = 2.5) -> dict:
    """What a session beside the robot with those options came to."""
    player = moving(start, robot, domain, seconds + 0.7, *options)
    code, text, err = ended(twin_of(start, seconds, out))
    assert code == 0, (err, player.poll())
    facts: dict = json.loads(text)
    return facts


def test_a_robot_that_is_as_its_twin_is_followed_and_its_law_is_known(
    start: Start, robot: Path, domain: int, tmp_path: Path
):
    facts = beside(start, robot, domain, tmp_path / "out", "--shuffled", seconds=4.0)
    assert facts["counts"]["samples"] >= 2000 and facts["counts"]["missing"] == 0
    # a count of rounding in another library's libm
    assert all(facts["residuals"][f"command {i}"]["rms"] < 0.01 for i in (1, 2, 3))
    assert all(facts["residuals"][f"plant joint {i}"]["rms"] < 0.001 for i in (1, 2, 3))


@pytest.mark.parametrize(
    ("options", "expected"),
    [
        (["--publishers", "2"], {"late": 0, "restarts": 0}),
        (["--clock-offset-s", "0.3", "--clock-drift", "5e-5"], {"missing": 0, "restarts": 0}),
        (["--restart-at-s", "1"], {"restarts": 1, "late": 0}),
        (["--nan-at-s", "1"], {"invalid": 50}),
        (["--silent", "1.0", "0.6"], {"missing": 300, "gaps": 1}),
    ],
    ids=["two publishers", "clock", "restart", "nan", "silent"],
)
def test_what_goes_wrong_is_counted_and_the_twin_goes_on(
    start: Start, robot: Path, domain: int, tmp_path: Path, options: list[str], expected: dict[str, int]
):
    facts = beside(start, robot, domain, tmp_path / "out", *options)
    assert expected.items() <= facts["counts"].items()
    assert facts["seconds"] >= 2.5
    if "--clock-offset-s" in options:
        assert facts["clock_offset_s"] == pytest.approx(-0.3, abs=0.02)
    recording = read(tmp_path / "out")
    assert recording.complete and len(recording["estimator.p_B"]) == facts["counts"]["samples"]


@pytest.mark.parametrize(
    ("options", "expected"),
    [
        (["--missing", "l3"], "/joint_states has no 'position.l3' for estimator.theta_l[2]; did you mean"),
        (["--degrees"], "as degrees they do: write in the map:"),
    ],
    ids=["missing joint", "degrees"],
)
def test_what_cannot_be_this_robot_is_refused_with_what_to_write(
    start: Start, robot: Path, domain: int, tmp_path: Path, options: list[str], expected: str
):
    moving(start, robot, domain, 20.0, *options)
    code, _, err = ended(twin_of(start, 10.0, tmp_path / "out"))
    assert (code, expected in err) == (2, True), err
    assert len(err.strip().splitlines()) <= 8 and not list(tmp_path.rglob("*.mcap"))


def test_a_twin_that_is_late_joins_and_stays_when_the_robot_is_switched_off_and_on(
    start: Start, robot: Path, domain: int, tmp_path: Path
):
    first = moving(start, robot, domain, 60.0, "--at-once")
    assert first.stdout is not None and first.stdout.readline() == "ready\n"
    time.sleep(0.5)
    twin = twin_of(start, 8.0, tmp_path / "out")
    until = time.monotonic() + 40.0
    while not (tmp_path / "out" / "run.mcap.partial").is_file() and time.monotonic() < until:
        time.sleep(0.05)
    first.kill()
    moving(start, robot, domain, 60.0)
    code, text, err = ended(twin)
    facts = json.loads(text)
    # its stamps go on, as its clock has gone on
    assert code == 0 and facts["counts"]["restarts"] == 0 and facts["counts"]["gaps"] >= 1, err
    events = [str(event) for event in read(tmp_path / "out").events]
    assert any("the plant model restarts" in event for event in events)
    # what came after it was on again
    assert facts["counts"]["missing"] < 500 * facts["seconds"] - 100


def test_lost_and_late_messages_are_counted_and_drift_is_seen(start: Start, robot: Path, domain: int, tmp_path: Path):
    facts = beside(start, robot, domain, tmp_path / "lost", "--loss", "0.05", "--jitter-ms", "5")
    counts = facts["counts"]
    # 62 +- 8 of 1250
    assert 0.02 < counts["missing"] / (counts["samples"] + counts["missing"]) < 0.09
    facts = beside(start, robot, domain, tmp_path / "drift", "--drift-deg-per-s", "0.2", seconds=4.0)
    assert facts["residuals"]["plant joint 1"]["rms"] > 3 * facts["residuals"]["plant joint 2"]["rms"]


def test_a_softer_spring_is_seen_in_the_joints(start: Start, domain: int, tmp_path: Path):
    robot = played(tmp_path, "plant.k_s_Nm_per_rad=0.7")
    facts = beside(start, robot, domain, tmp_path / "out", seconds=4.0)
    assert max(facts["residuals"][f"plant joint {i}"]["rms"] for i in (1, 2, 3)) > 0.003
