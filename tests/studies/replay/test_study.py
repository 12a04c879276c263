import json
import shlex
from pathlib import Path

import pytest

from tests.studies.replay.logs import ANGLES, EXPERIMENTS, FIG4, ran, softened, write_log
from twin.kernel.errors import InputRefused
from twin.kernel.recording.reader import read
from twin.studies.replay.study import replay
from twin.studies.result import Result

ROBOT = EXPERIMENTS / f"{FIG4}.toml"
FORCE = "scale.F_z=scale.F_z"


def lines(report: Result) -> list[str]:
    assert all(len(line) <= 80 for line in report.text.splitlines() if "/" not in line)
    return report.text.splitlines()


def test_a_healthy_robots_report_says_so_first_and_where_the_files_are_last(tmp_path: Path):
    log = write_log(tmp_path / "monday.csv", ran(FIG4), angles=True)
    report = replay(log, ROBOT, [*ANGLES, FORCE], plant=True, out=tmp_path / "out")
    assert report.exit_code == 0
    assert lines(report)[0] == "monday: robot and twin match, 0 to 20 s"
    assert sorted(path.name for path in (tmp_path / "out").iterdir()) == ["replay.json", "replay.png", "run.mcap"]
    assert lines(report)[-2].endswith(f"{tmp_path / 'out' / 'replay.json'}")
    # with the very options that this log needed
    maps = " ".join(f"--map {shlex.quote(str(one))}" for one in (*ANGLES, FORCE))
    assert lines(report)[-1] == f"  next       twin identify {log} --experiment {ROBOT} {maps}"
    assert read(tmp_path / "out" / "run.mcap").complete


def test_a_robot_that_drifts_is_told_with_time_size_and_side(tmp_path: Path):
    log = write_log(tmp_path / "monday.csv", ran(FIG4, softened((1, 2, 3), 10.0)))
    report = replay(log, ROBOT, out=tmp_path / "out")
    assert report.exit_code == 1
    assert lines(report)[0] == "monday: robot and twin diverge since 10.000 s"
    assert "N above the measured force" in lines(report)[1]
    facts = json.loads((tmp_path / "out" / "replay.json").read_text())
    assert facts["verdict"] == "drifting"
    assert facts["indicators"][0]["alarm_s"] == pytest.approx(12.0)


def test_with_nothing_independent_to_compare_the_report_claims_nothing(tmp_path: Path):
    log = write_log(tmp_path / "monday.csv", ran(FIG4), angles=True)
    report = replay(log, ROBOT, ANGLES, out=tmp_path / "out")
    assert report.exit_code == 0
    assert lines(report)[0] == "monday: cannot tell whether robot and twin match"
    assert report.facts["verdict"] == "cannot tell"
    assert "nothing" in report.text
    maps = " ".join(f"--map {shlex.quote(str(one))}" for one in ANGLES)
    assert report.facts["next"] == f"twin replay {log} --plant --experiment {ROBOT} {maps}"


@pytest.mark.slow
def test_the_same_log_gives_the_same_files(tmp_path: Path):
    for name in "ab":
        replay(ran(FIG4).path, plant=True, out=tmp_path / name)
    for file in ("run.mcap", "replay.png", "replay.json"):
        assert (tmp_path / "a" / file).read_bytes() == (tmp_path / "b" / file).read_bytes()


def test_a_log_that_does_not_say_whose_it_is_needs_an_experiment(tmp_path: Path):
    log = write_log(tmp_path / "monday.csv", ran(FIG4))
    with pytest.raises(InputRefused, match=r"does not name its robot; give its experiment with --experiment"):
        replay(log, out=tmp_path / "out")
    assert not (tmp_path / "out").exists()


@pytest.mark.parametrize(
    ("setting", "said"),
    [
        ("plant.k_s=1", "[plant] unknown key 'k_s'; did you mean 'k_s_Nm_per_rad'?"),
        ("robot.k_s_Nm_per_rad=1", "[robot] unknown key 'robot'; known are plant, contact, cosim, controller, scale"),
        ("plant.N=-1", "[plant] N = -1: expected a number > 0"),
    ],
)
def test_settings_of_a_recorded_experiment_are_checked(tmp_path: Path, setting: str, said: str):
    with pytest.raises(InputRefused) as refused:
        replay(ran(FIG4).path, settings=[setting], out=tmp_path / "out")
    assert said in str(refused.value)


def test_a_setting_of_the_recorded_experiment_changes_the_twin(tmp_path: Path):
    settings = ["controller.model.k_s_Nm_per_rad=1.2"]
    assert replay(ran(FIG4).path, settings=settings, out=tmp_path / "out").exit_code == 1
