import json
from pathlib import Path

import numpy as np
import pytest
from PIL import Image

from tests.cli.test_run import twin
from twin.recording.recording import Recording


@pytest.fixture
def digits(force_position: Recording, tmp_path: Path) -> Path:
    """The pressing force of the run as someone else's CSV: other names, units, sign and clock, four digits."""
    t, F_z = force_position.time("controller"), force_position["controller.F_z"]
    rows = [f"{1000.0 * (time + 7.0):.0f},{-1000.0 * force:.1f},ok" for time, force in zip(t, F_z, strict=True)]
    path = tmp_path / "robot.csv"
    path.write_text("\n".join(["stamp,Fz,state", *rows[::5]]) + "\n")
    return path


MAP = ("--map", "time=stamp[ms]", "--map", "controller.F_z=-Fz[mN]")


def test_a_log_of_the_same_run_is_inside_once_it_is_mapped_and_aligned(
    force_position: Recording, digits: Path, tmp_path: Path
):
    done = twin(
        "compare", force_position.path, digits, *MAP, "--align", "fit", "--by", "controller.F_z", "--max-shift", "10",
        "--tol", "1mN", cwd=tmp_path,
    )  # fmt: skip
    assert done.returncode == 0, done.stderr
    assert done.stdout.startswith("B stays within the tolerance tube of A: 1 signal compared\n")
    facts = json.loads((tmp_path / "results/compare/compare.json").read_text())
    assert facts["shift"] == pytest.approx(-7.0, abs=1e-4)  # stamps of whole ms, fitted to a thousandth of 10 ms steps
    with Image.open(tmp_path / "results/compare/compare.png") as picture:
        assert picture.width >= 600


def test_another_run_is_outside_and_the_first_point_is_named(
    force_position: Recording, position: Recording, tmp_path: Path
):
    done = twin("compare", force_position.path, position.path, "--signal", "controller.F_z", cwd=tmp_path)
    assert done.returncode == 1
    lines = done.stdout.splitlines()
    assert lines[0].startswith("1 of 1 signal leave the tube: controller.F_z first, at 5.6")
    assert lines[6].startswith("       out at 5.6")
    assert max(map(len, lines[4:])) <= 80


def test_the_same_run_is_identical(position: Recording, tmp_path: Path):
    done = twin("compare", position.path, position.path, "--json", "--out", tmp_path / "out", cwd=tmp_path)
    assert done.returncode == 0, done.stderr
    facts = json.loads(done.stdout)
    assert facts["identical"] and facts["inside"]
    assert {row["max_error"] for row in facts["rows"]} == {0.0}


def test_what_cannot_be_compared_is_refused_in_one_sentence(position: Recording, digits: Path, tmp_path: Path):
    (tmp_path / "empty.csv").write_text("")
    (tmp_path / "cut.mcap").write_bytes(position.path.read_bytes()[:-1000])
    damaged = bytearray(position.path.read_bytes())
    damaged[len(damaged) // 2] ^= 255
    (tmp_path / "damaged.mcap").write_bytes(damaged)
    run = position.path
    for words, expected in (
        ((run,), "got 1 path, expected A and B, or --paper FIGURE"),
        ((run, "nowhere.csv"), "nowhere.csv: cannot be read: No such file or directory"),
        ((run, "empty.csv"), "empty.csv: an empty file"),
        ((run, "damaged.mcap"), "damaged.mcap: damaged at byte"),
        ((run, digits), "robot.csv: no column of time; it has stamp, Fz, state"),
        ((run, run, *MAP), "--map: both are recordings of twin"),
        ((run, run, "--align", "up"), "--align up: expected one of none, start, event, fit"),
        ((run, run, "--tol", "plant.x=1N"), "tolerance of plant.x: no such signal"),
        ((run, run, "--paper", "fig4", "--tol", "1%"), "--paper fig4: takes no --signal"),
    ):
        done = twin("compare", *words, cwd=tmp_path)
        assert done.returncode == 2, done.stdout
        assert expected in done.stderr
        assert len(done.stderr.splitlines()) == 1


def test_an_unfinished_run_is_compared_as_far_as_it_goes_and_says_so(position: Recording, tmp_path: Path):
    half = tmp_path / "half.mcap"
    content = position.path.read_bytes()
    half.write_bytes(content[: len(content) // 2])
    done = twin("compare", position.path, half, cwd=tmp_path)
    assert done.returncode == 0, done.stderr
    assert "unfinished recording: read up to" in " ".join(done.stdout.split())


def test_a_digitised_curve_is_judged_by_its_own_uncertainty(force_position: Recording, tmp_path: Path):
    t = np.linspace(0.5, 19.5, 60)
    F_z = np.interp(t, force_position.time("controller"), force_position["controller.F_z"])
    head = (
        '# [figure]\n# number = "0"\n# panel = "Z"\n# curve = "made for a test"\n# image = "none"\n'
        '# [digitised]\n# by = "a test"\n# on = 2026-01-31\n# tool = "none"\n'
        "# [calibration]\n# t_s = [[0, 0.0], [2000, 20.0]]\n# controller.F_z_N = [[900, 0.0], [100, 8.0]]\n"
        "# [uncertainty]\n# t_s = 0.05\n# controller.F_z_N = 0.2\n"
    )
    for off, code in ((0.15, 0), (0.3, 1)):
        rows = "".join(f"{time:.2f},{force + off:.3f}\n" for time, force in zip(t, F_z, strict=True))
        (tmp_path / "curve.csv").write_text(f"{head}t_s,controller.F_z_N\n{rows}")
        done = twin("compare", force_position.path, "curve.csv", cwd=tmp_path)
        assert done.returncode == code, done.stdout + done.stderr
        assert "Fig. 0 Z, made for a test: digitised by a test on 2026-01-31" in done.stdout
