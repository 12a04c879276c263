import json
from pathlib import Path

import pytest

from tests.command_line import twin
from tests.kernel.process.hostile import SEGFAULT, hostile_drive
from tests.studies.check.files import step_file


def test_a_check_goes_from_accepted_to_as_it_was_to_deviating(root: Path, tmp_path: Path):
    mine = step_file(root, tmp_path / "mine.toml")
    drives = ["--drive", "own", "--drive", "stepper"]
    first = twin("check", mine, *drives, "--update", "--reason", "first", cwd=tmp_path)
    assert first.returncode == 0, first.stderr
    assert first.stdout.startswith("New: 1 experiment, 2 drives")
    assert "written  2 of 2 baselines in tests/baselines" in first.stdout
    assert not (tmp_path / "results").exists()
    # without --drive all that have a baseline
    again = twin("check", mine, "--isolate", "none", cwd=tmp_path)
    assert again.returncode == 0, again.stderr
    assert again.stdout.startswith("All as it was: 1 experiment, 2 drives")
    step_file(root, mine, "[controller.position]\nkp_per_s = 2.0")
    changed = twin("check", mine, "--json", cwd=tmp_path)
    assert changed.returncode == 1
    verdicts = json.loads(changed.stdout)["verdicts"]
    assert [verdict["drive"] for verdict in verdicts] == ["own", "stepper"]
    assert {row["word"] for row in verdicts[0]["rows"]} >= {"better", "outside"}
    assert verdicts[0]["outside"][0]["signal"] == "plant.p_B[2]"
    assert len(list((tmp_path / "results/check").glob("*.png"))) == 2


@pytest.mark.parametrize(
    ("words", "said"),
    [
        (["mine.toml", "--update"], "--update and --reason"),
        (["mine.toml", "--update", "--reason", " "], "--update and --reason"),
        (["mine.toml", "--reason", "why"], "--update and --reason"),
        ([], "tests/baselines: no baselines there"),
        (["mine.toml"], "tests/baselines/mine/own.toml: no baseline of mine; accept its present values: twin check"),
        (["mine.toml", "--baselines", "kept"], "--drive own --baselines kept --update --reason"),
        (["mine.toml", "--drive", "steper"], "steper: no such drive"),
        (["mien.toml"], "no such experiment file"),
    ],
)
def test_what_cannot_be_checked_is_refused_in_a_sentence(root: Path, tmp_path: Path, words: list[str], said: str):
    step_file(root, tmp_path / "mine.toml")
    (tmp_path / "tests/baselines").mkdir(parents=True)
    done = twin("check", *words, "--isolate", "none", cwd=tmp_path)
    assert done.returncode == 2
    # sentences are folded at 80 columns
    assert said in " ".join((done.stdout + done.stderr).split())
    assert not list((tmp_path / "tests/baselines").iterdir())


def test_a_drive_that_crashes_is_named_and_the_others_are_checked(root: Path, tmp_path: Path):
    crashing = hostile_drive(root, tmp_path)
    drive = f"[drive]\nfmu = '{crashing}'\n[drive.joint_2]\nparameters = {{ droop = {SEGFAULT} }}"
    mine, other = step_file(root, tmp_path / "mine.toml", drive), step_file(root, tmp_path / "other.toml")
    words = [mine, other, "--drive", "own", "-j", "1", "--update", "--reason", "x"]
    done = twin("check", *words, cwd=tmp_path, isolated=True)
    assert done.returncode == 3
    assert "hostile.fmu (drive_2) crashed" in " ".join(done.stdout.split())
    assert [path.name for path in (tmp_path / "tests/baselines").iterdir()] == ["other"]
