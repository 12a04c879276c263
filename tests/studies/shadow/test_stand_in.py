"""`twin shadow` beside the stand-in: exported FMUs in FMPy, with what the twin is not told."""

import json
import sys
from pathlib import Path

import pytest

from tests.conftest import ROOT
from tests.studies.replay.logs import FIG4
from tests.studies.shadow.conftest import Start
from tests.studies.shadow.test_live import ended
from twin.kernel.recording.reader import read
from twin.studies.build.study import build
from twin.studies.command import silent

STAND_IN = ROOT / "examples" / "robot_stand_in"
pytestmark = pytest.mark.slow


@pytest.fixture(scope="session")
def robot(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Its parts."""
    folder = tmp_path_factory.mktemp("stand_in")
    for part in ("plant", "computer"):
        build(Path(FIG4), silent, fmu=part, out=folder / f"{part}.fmu")
    return folder


def beside(start: Start, robot: Path, domain: int, out: Path, *options: str) -> dict:
    """What a session of 4 s beside the robot with those options came to."""
    words = [sys.executable, STAND_IN / "robot.py", robot, "--domain", domain, "--seconds", 5, *options]
    stand_in = start(*words)
    twin = [sys.executable, "-m", "twin", "shadow", FIG4, "--source", "ros2:/joint_states"]
    code, text, err = ended(start(*twin, "--map", STAND_IN / "robot.toml", "--duration-s", 4, "--json", "--out", out))
    assert code == 0, (err, stand_in.poll())
    return json.loads(text)


def test_a_robot_that_is_as_its_twin_is_followed_and_its_law_is_known(
    start: Start, robot: Path, domain: int, tmp_path: Path
):
    facts = beside(start, robot, domain, tmp_path / "out", "--shuffled")
    assert facts["counts"]["samples"] >= 2000 and facts["counts"]["missing"] == 0
    # a count of rounding in another library's libm
    assert all(facts["residuals"][f"command {i}"]["rms"] < 0.01 for i in (1, 2, 3))
    assert all(facts["residuals"][f"joint {i}"]["rms"] < 0.001 for i in (1, 2, 3))


@pytest.mark.parametrize(
    ("options", "expected"),
    [
        (["--publishers", "2"], {"late": 0, "restarts": 0}),
        (["--clock-offset-s", "0.3", "--clock-drift", "5e-5"], {"missing": 0, "restarts": 0}),
        (["--restart-at-s", "2"], {"restarts": 1, "late": 0}),
        (["--nan-at-s", "2"], {"invalid": 50}),
        (["--silent", "1.5", "1.0"], {"missing": 500, "gaps": 1}),
    ],
    ids=["two publishers", "clock", "restart", "nan", "silent"],
)
def test_what_goes_wrong_is_counted_and_the_twin_goes_on(
    start: Start, robot: Path, domain: int, tmp_path: Path, options: list[str], expected: dict[str, int]
):
    facts = beside(start, robot, domain, tmp_path / "out", *options)
    assert expected.items() <= facts["counts"].items()
    assert facts["seconds"] >= 4.0
    if "--clock-offset-s" in options:
        assert facts["clock_offset_s"] == pytest.approx(-0.3, abs=0.02)
    recording = read(tmp_path / "out")
    assert recording.complete and len(recording["estimator.p_B"]) == facts["counts"]["samples"]


def test_a_softer_spring_is_seen_in_the_joints(start: Start, robot: Path, domain: int, tmp_path: Path):
    facts = beside(start, robot, domain, tmp_path / "out", "--set", "plant.k_s_Nm_per_rad=0.7")
    assert max(facts["residuals"][f"joint {i}"]["rms"] for i in (1, 2, 3)) > 0.003
