import json
from pathlib import Path

import pytest
from PIL import Image

from tests.command_line import twin

AIR = "experiments/step_z_air.toml"


def test_tune_prints_the_verdict_first_and_writes_an_experiment_that_runs(root: Path, tmp_path: Path):
    done = twin("tune", root / AIR, cwd=tmp_path)
    assert done.returncode == 0, done.stderr
    assert done.stdout.splitlines()[0] == "step_z_air  GOALS MET at the one corner, and the co-simulation agrees"
    files = [tmp_path / line.strip() for line in done.stdout.splitlines()[-3:]]
    assert [file.name for file in files] == ["tuned.toml", "tuning.png", "tuning.json"]
    with Image.open(files[1]) as image:
        assert image.width >= 700
    assert json.loads(files[2].read_text())["met"] is True
    again = next(line for line in done.stdout.splitlines() if line.startswith("next  "))
    assert twin(*again.split()[2:], cwd=tmp_path).returncode == 0


def test_goals_that_are_not_met_are_exit_code_1(root: Path, tmp_path: Path):
    done = twin("tune", root / AIR, "--bandwidth-Hz", "50", "--json", cwd=tmp_path)
    assert done.returncode == 1, done.stderr
    assert json.loads(done.stdout)["missed"] == ["bandwidth"]


@pytest.mark.parametrize(
    ("option", "sentence"),
    [
        (("--margin", "1"), "--margin 1: no loop has"),
        (("--drive", "no_such_drive"), "no such drive"),
    ],
)
def test_what_makes_no_sense_is_refused_in_one_sentence(root: Path, tmp_path: Path, option, sentence: str):
    done = twin("tune", root / AIR, *option, cwd=tmp_path)
    assert done.returncode == 2
    assert sentence in done.stderr and len(done.stderr.splitlines()) == 1
