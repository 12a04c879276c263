import json
from pathlib import Path

import pytest
from PIL import Image

from tests.command_line import twin
from tests.studies.paper.fig5_recordings import pressed, tapped
from twin.kernel.recording.reader import Recording


@pytest.mark.slow
def test_the_scorecard_has_every_claim_and_the_picture_is_drawn(
    force_position: Recording, position: Recording, imperfect: tuple[Recording, Recording], tmp_path: Path
):
    four = [recording.path for recording in (force_position, position, *imperfect)]
    done = twin("compare", "--paper", "fig4", *four, cwd=tmp_path)
    assert done.returncode == 0, done.stderr
    assert done.stdout.splitlines()[0].endswith("25 of 31 claims of the paper's text hold, 6 not reproduced")
    assert "n/a  imperfect" not in done.stdout and "Imperfect: scale tilted" in done.stdout
    assert max(len(line) for line in done.stdout.splitlines()) <= 80
    facts = json.loads((tmp_path / "results/fig4/fig4.json").read_text())
    assert facts["failed"] == []
    assert {claim["verdict"] for claim in facts["claims"]} == {"holds", "not reproduced"}
    assert all(claim["quote"] and claim["text"] for claim in facts["claims"])
    assert facts["tuned"] and facts["out_of_scope"]
    with Image.open(tmp_path / "results/fig4/fig4.png") as picture:
        assert picture.width >= 1200


def test_a_claim_that_fails_is_exit_code_1_and_named(position: Recording, tmp_path: Path):
    done = twin("compare", "--paper", "fig4", position.path, position.path, "--json", cwd=tmp_path)
    assert done.returncode == 1
    assert "trigger_time" in json.loads(done.stdout)["failed"]


def test_two_runs_are_scored_but_for_the_forces_in_x(force_position: Recording, position: Recording, tmp_path: Path):
    done = twin("compare", "--paper", "fig4", force_position.path.parent, position.path.parent, cwd=tmp_path)
    assert done.returncode == 0, done.stderr
    assert done.stdout.splitlines()[0].endswith("23 of 29 claims of the paper's text hold, 6 not reproduced")
    assert done.stdout.count("\n  n/a ") == 2
    assert done.stdout.count("needs the runs of fig4_imperfect.toml and fig4_imperfect_position.toml") == 1
    assert "Imperfect: scale tilted" not in done.stdout


def test_what_is_no_recording_and_no_figure_is_refused(position: Recording, tmp_path: Path):
    assert "no recording" in twin("compare", "--paper", "fig4", "nowhere", position.path, cwd=tmp_path).stderr
    done = twin("compare", "--paper", "fig9", position.path, position.path, cwd=tmp_path)
    assert done.returncode == 2
    assert "expected one of fig4" in done.stderr


@pytest.mark.parametrize("count", [1, 3, 5])
def test_fig4_needs_two_runs_or_four(position: Recording, tmp_path: Path, count: int):
    done = twin("compare", "--paper", "fig4", *[position.path] * count, cwd=tmp_path)
    assert done.returncode == 2
    assert f"got {count} run" in done.stderr and "expected two: the run with force control" in done.stderr


def test_fig4_without_runs_takes_the_latest_or_says_how_to_make_them(tmp_path: Path):
    done = twin("compare", "--paper", "fig4", cwd=tmp_path)
    assert done.returncode == 2
    assert "twin run experiments/fig4_force_position.toml" in done.stderr
    assert "experiments/fig4_imperfect_position.toml" in done.stderr


def test_fig5_takes_any_number_of_runs_and_says_the_verdict_first(tmp_path: Path):
    runs = [tmp_path / "press", tmp_path / "tap"]
    for folder in runs:
        folder.mkdir()
    pressed(runs[0])
    tapped(runs[1])
    done = twin("compare", "--paper", "fig5", *runs, cwd=tmp_path)
    assert done.returncode == 0, done.stderr
    assert done.stdout.splitlines()[0].endswith("16 of 16 claims of the paper's text hold")
    assert max(len(line) for line in done.stdout.splitlines()) <= 80
    facts = json.loads((tmp_path / "results/fig5/fig5.json").read_text())
    assert [task["kind"] for task in facts["tasks"]] == ["press", "tap"]
    with Image.open(tmp_path / "results/fig5/fig5.png") as picture:
        assert picture.width >= 600


def test_a_task_that_fails_is_exit_code_1_and_named(tmp_path: Path):
    pressed(tmp_path, force=-0.5)
    done = twin("compare", "--paper", "fig5", tmp_path, "--json", "--out", tmp_path / "out", cwd=tmp_path)
    assert done.returncode == 1
    assert "hold_mean" in json.loads(done.stdout)["tasks"][0]["failed"]


def test_fig5_without_runs_takes_the_latest_or_says_how_to_make_them(tmp_path: Path):
    done = twin("compare", "--paper", "fig5", cwd=tmp_path)
    assert done.returncode == 2
    assert "first: twin run experiments/pressing.toml" in done.stderr


def test_a_run_without_tasks_is_refused_in_one_sentence(position: Recording, tmp_path: Path):
    done = twin("compare", "--paper", "fig5", position.path, cwd=tmp_path)
    assert done.returncode == 2
    assert "holds no task" in done.stderr and len(done.stderr.splitlines()) == 1
