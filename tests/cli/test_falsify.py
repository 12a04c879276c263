"""`twin falsify` as a user types it."""

import json
import tomllib
from pathlib import Path

from tests.command_line import twin

BOUND = "always (|plant.F_ee_B| <= 18 N)"


def test_settings_body_and_drive_stand_in_what_is_found(root: Path, tmp_path: Path):
    options = (
        "--kind",
        "surface_jump",
        "--runs",
        "3",
        "--body",
        "calf",
        "-j",
        "1",
        "--set",
        "task.1.force_N=7",
        "--json",
    )
    experiment = root / "experiments/pressing.toml"
    done = twin("falsify", experiment, "--requirement", BOUND, *options, "--drive", "ideal_velocity", cwd=tmp_path)
    assert done.returncode == 1, done.stderr
    facts = json.loads(done.stdout)
    assert facts["runs"] == 3
    found = tomllib.loads((tmp_path / "results/falsify/pressing/surface_jump.toml").read_text())
    assert found["task"] == {"1": {"force_N": 7}} and "ideal_velocity" in found["drive"]["fmu"]
    (one,) = facts["found"]
    assert (found.get("contact") == {"body": "calf"}) == (one["body"] == "calf")


def test_a_formula_that_is_none_is_one_sentence_and_exit_code_2(root: Path, tmp_path: Path):
    done = twin("falsify", root / "experiments/pressing.toml", "--requirement", "always(", cwd=tmp_path)
    assert done.returncode == 2 and len(done.stderr.splitlines()) == 1
    assert "expected a signal such as" in done.stderr
