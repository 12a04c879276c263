import json
from pathlib import Path

from PIL import Image

from tests.cli.test_run import twin
from twin.recording.recording import Recording


def test_the_scorecard_has_every_claim_and_the_picture_is_drawn(
    force_position: Recording, position: Recording, tmp_path: Path
):
    done = twin("compare", "--paper", "fig4", force_position.path, position.path, cwd=tmp_path)
    assert done.returncode == 0, done.stderr
    assert "claims hold" in done.stdout.splitlines()[0]
    assert max(len(line) for line in done.stdout.splitlines()) <= 80
    facts = json.loads((tmp_path / "results/fig4/fig4.json").read_text())
    assert facts["failed"] == []
    assert {claim["verdict"] for claim in facts["claims"]} == {"holds", "trivial", "not reproducible"}
    assert all(claim["quote"] and claim["text"] for claim in facts["claims"])
    assert facts["tuned"] and facts["out_of_scope"]
    with Image.open(tmp_path / "results/fig4/fig4.png") as picture:
        assert picture.width >= 1200


def test_a_claim_that_fails_is_exit_code_1_and_named(position: Recording, tmp_path: Path):
    done = twin("compare", "--paper", "fig4", position.path, position.path, "--json", cwd=tmp_path)
    assert done.returncode == 1
    assert "trigger_time" in json.loads(done.stdout)["failed"]


def test_runs_are_found_by_folder(force_position: Recording, position: Recording, tmp_path: Path):
    done = twin("compare", "--paper", "fig4", force_position.path.parent, position.path.parent, cwd=tmp_path)
    assert done.returncode == 0, done.stderr


def test_what_is_no_recording_and_no_figure_is_refused(position: Recording, tmp_path: Path):
    assert "no recording" in twin("compare", "--paper", "fig4", "nowhere", position.path, cwd=tmp_path).stderr
    done = twin("compare", "--paper", "fig9", position.path, position.path, cwd=tmp_path)
    assert done.returncode == 2
    assert "expected one of fig4" in done.stderr
