"""`twin faults` as a user types it."""

import json
from pathlib import Path

import pytest
from PIL import Image

from tests.command_line import twin
from tests.kernel.fmi.compiled import compiled_drive
from twin.studies.faults.study import MATRIX_FILE, PICTURE_FILE, ROWS_FILE

PRESSING = "experiments/pressing.toml"
CRASHES_WHEN_RETRACTED = """
#include <signal.h>
#include "model.h"
bool model_step(Variables *v, double h)
{
    v->theta_m += v->omega_ref * h;
    if (v->omega_ref < -1.99) { /* no task commands that; the monitor's retraction does */
        signal(SIGSEGV, SIG_DFL);
        *(volatile int *)8 = 1;
    }
    return true;
}
"""


def test_rows_picture_and_json_lie_in_the_folder_and_the_verdict_comes_first(root: Path, tmp_path: Path):
    done = twin("faults", root / PRESSING, "--kind", "surface_jump", "--out", "mine", cwd=tmp_path)
    assert done.returncode == 0, done.stderr
    assert done.stdout.startswith("pressing  as stated: 5 of 6 below 18 N")
    assert max(map(len, done.stdout.splitlines())) <= 80
    folder = tmp_path / "mine"
    rows = [json.loads(line) for line in (folder / ROWS_FILE).read_text().splitlines()]
    assert rows == json.loads((folder / MATRIX_FILE).read_text())["rows"]
    assert len(rows) == 6
    with Image.open(folder / PICTURE_FILE) as image:
        assert image.width >= 1000


def test_json_has_one_row_per_case_with_both_runs(root: Path, tmp_path: Path):
    options = ("--kind", "drive_dead", "--onset", "0.5", "--duration", "0.5", "--isolate", "none", "--json")
    done = twin("faults", root / PRESSING, *options, cwd=tmp_path)
    (row,) = json.loads(done.stdout)["rows"]
    assert (row["kind"], row["onset_s"], row["verdict"]) == ("drive_dead", 0.5, "safe")
    assert row["with_monitor"]["reason"] and not row["without_monitor"]["reason"]
    assert (tmp_path / "results/faults/pressing" / PICTURE_FILE).is_file()


BACK = ("--set-of", "single", "--body", "back", "--onset", "5.5")


def test_a_fault_that_goes_beyond_the_bound_and_was_not_said_to_is_exit_code_1(root: Path, tmp_path: Path):
    # the old reaction takes the power later than an ideal monitor
    slow = ("--set", "monitor.force_limit_N=9", "--set", "monitor.disobeyed=wait", "--kind", "drive_runaway")
    done = twin("faults", root / PRESSING, *BACK, *slow, cwd=tmp_path)
    assert done.returncode == 1, done.stderr
    assert done.stdout.startswith("pressing  FAILED")
    assert "! above the bound, and not expected there:" in done.stdout


def test_what_no_monitor_betters_is_said_with_what_an_ideal_one_reaches(root: Path, tmp_path: Path):
    done = twin("faults", root / PRESSING, *BACK, "--kind", "surface_jump", "--json", cwd=tmp_path)
    assert done.returncode == 0, done.stderr
    (_, back, _) = json.loads(done.stdout)["rows"]
    # a back that jumps by 5 mm: the force is at its limit after 7 ms
    assert back["with_monitor"]["peak_N"] == pytest.approx(20.2, rel=0.02) == back["ideal_peak_N"]
    assert back["magnitude_mm"] == 5.0 and not back["failed"] and not back["expected_beyond"]


def test_poses_are_tried_and_the_worst_comes_first(root: Path, tmp_path: Path):
    moved = ("--set-of", "common", "--kind", "power_off", "--onset", "5.5", "--reach-mm", "15")
    done = twin("faults", root / PRESSING, *moved, cwd=tmp_path)
    assert done.returncode == 0, done.stderr
    assert max(map(len, done.stdout.splitlines())) <= 80 and "at mm" in done.stdout
    rows = json.loads((tmp_path / "results/faults/pressing" / MATRIX_FILE).read_text())["together"]
    assert {tuple(row["offset_m"]) for row in rows} == {(0, 0), (0.015, 0), (0, 0.015), (-0.015, 0), (0, -0.015)}
    worst = max(rows, key=lambda row: row["with_monitor"]["peak_N"])
    x, y = (1e3 * each for each in worst["offset_m"])
    assert f"{x:.3g}, {y:.3g}" in done.stdout
    none = twin("faults", root / PRESSING, "--reach-mm", "40", cwd=tmp_path)
    assert none.returncode == 2 and "from the axis" in none.stderr


@pytest.mark.parametrize(
    ("experiment", "options", "told"),
    [
        (PRESSING, ("--kind", "drive_runway"), "did you mean 'drive_runaway'"),
        (PRESSING, ("--onset", "99"), "--onset 99: outside the experiment; expected 0 <= S < 13"),
        (PRESSING, ("--out", "/dev/null/x"), "cannot be created"),
        ("experiments/fig4_force_position.toml", (), "add a table [monitor]"),
    ],
)
def test_bad_input_is_one_sentence_and_exit_code_2(root: Path, tmp_path: Path, experiment, options, told):
    done = twin("faults", root / experiment, *options, cwd=tmp_path)
    assert done.returncode == 2, done.stderr
    assert told in done.stderr
    assert len(done.stderr.splitlines()) == 1


def test_a_trip_without_any_fault_is_exit_code_4(root: Path, tmp_path: Path):
    done = twin("faults", root / PRESSING, "--set", "monitor.speed_limit_mm_per_s=50", cwd=tmp_path)
    assert done.returncode == 4, done.stderr
    assert "without any fault: safety monitor: " in done.stderr


def test_a_drive_that_crashes_costs_one_sentence_and_no_finished_row(root: Path, tmp_path: Path):
    drive = compiled_drive(root, tmp_path, "fragile", {"model.c": CRASHES_WHEN_RETRACTED})
    kinds = ("--kind", "encoder_bias", "--onset", "5.5", "--drive", drive)
    done = twin("faults", root / PRESSING, *kinds, "--out", "mine", cwd=tmp_path, isolated=True)
    assert done.returncode == 3, done.stderr
    assert "fragile.fmu (drive_1) crashed (SIGSEGV" in done.stderr and "Traceback" not in done.stderr
    # 0.1 and 0.5 deg trip nothing, 2 deg do
    assert f"Kept until then: mine/{ROWS_FILE} (2 rows)." in done.stderr
    assert len((tmp_path / "mine" / ROWS_FILE).read_text().splitlines()) == 2
