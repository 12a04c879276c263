import inspect
import json
import re
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from PIL import Image

from tests.command_line import twin
from tests.kernel.recording import samples
from twin.cli.ask import ask
from twin.kernel.errors import InputRefused
from twin.kernel.recording.reader import Recording
from twin.studies.command import SHARED_OPTIONS
from twin.studies.compare import study


@pytest.fixture
def digits(force_position: Recording, tmp_path: Path) -> Path:
    """The pressing force of the run as someone else's CSV: other names, units, sign and clock, four digits."""
    t, F_z = force_position.time("controller"), force_position["controller.F_z"]
    rows = [f"{1000.0 * (time + 7.0):.0f},{-1000.0 * force:.1f},ok" for time, force in zip(t, F_z, strict=True)]
    path = tmp_path / "robot.csv"
    path.write_text("\n".join(["stamp,Fz,state", *rows[::5]]) + "\n")
    return path


DEFAULTS = {name: default for name, (_, default) in SHARED_OPTIONS.items()}
DEFAULTS |= {name: one.default for name, one in inspect.signature(study.compare).parameters.items() if name != "say"}


def compare(runs: list[Path], **options: Any) -> None:
    """Ask the study as the command line does."""
    ask(study.compare, {**DEFAULTS, "runs": runs, **options})


MAP = ("--map", "time=stamp[ms]", "--map", "controller.F_z=-Fz[mN]")


def test_a_log_of_the_same_run_is_inside_once_it_is_mapped_and_aligned(
    force_position: Recording, digits: Path, tmp_path: Path
):
    done = twin(
        "compare", force_position.path, digits, *MAP, "--align", "fit", "--by", "controller.F_z", "--max-shift", "10",
        "--tol", "1mN", cwd=tmp_path,
    )  # fmt: skip
    assert done.returncode == 0, done.stderr
    answer = " ".join(line.strip() for line in done.stdout.splitlines()[:2])
    assert re.fullmatch(
        r"1 of \d\d signals in common: B stays within the tolerance tube of A: 1 signal, all of A's time", answer
    )
    facts = json.loads((tmp_path / "results/compare/compare.json").read_text())
    assert facts["shift"] == pytest.approx(-7.0, abs=1e-4)  # stamps of whole ms, fitted to a thousandth of 10 ms steps
    with Image.open(tmp_path / "results/compare/compare.png") as picture:
        assert picture.width >= 600


def test_another_run_is_exit_code_1_and_the_first_point_outside_is_named(
    force_position: Recording, position: Recording, tmp_path: Path
):
    done = twin("compare", force_position.path, position.path, "--signal", "controller.F_z", cwd=tmp_path)
    assert done.returncode == 1
    lines = done.stdout.splitlines()
    assert lines[0].startswith("1 of 1 signal leaves the tube around A (first: controller.F_z, at 5.6")
    assert lines[7].startswith("       out at 5.6")
    assert max(map(len, lines[4:])) <= 80


def test_the_same_run_is_identical(
    position: Recording, tmp_path: Path, capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch
):
    monkeypatch.chdir(tmp_path)
    compare([position.path, position.path], signals=["plant.p_B"], out=Path("out"), as_json=True)
    facts = json.loads(capsys.readouterr().out)
    assert facts["identical"] and facts["inside"]
    assert {row["max_error"] for row in facts["rows"]} == {0.0}


@pytest.mark.parametrize(
    ("paths", "options", "expected"),
    [
        (["run.mcap"], {}, "got 1 path, expected A and B, or --paper FIGURE"),
        (["run.mcap", "nowhere.csv"], {}, "nowhere.csv: no such file"),
        (["run.mcap", "empty.csv"], {}, "empty.csv: an empty file"),
        (["run.mcap", "damaged.mcap"], {}, "damaged.mcap: damaged at byte"),
        (["run.mcap", "robot.csv"], {}, "robot.csv: no column of time; it has stamp, Fz, state"),
        (["run.mcap", "run.mcap"], {"maps": ["F=x[N]"]}, "--map: both are recordings of twin"),
        (["run.mcap", "run.mcap"], {"align": "up"}, "--align up: expected one of none, start, event, fit"),
        (["run.mcap", "run.mcap"], {"tolerances": ["plant.x=1N"]}, "tolerance of plant.x: no such signal"),
        (["run.mcap", "run.mcap"], {"paper": "fig4", "tolerances": ["1%"]}, "--paper fig4: takes no --signal"),
    ],
)
def test_what_cannot_be_compared_is_refused_in_one_sentence(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, paths: list[str], options: dict[str, Any], expected: str
):
    monkeypatch.chdir(tmp_path)
    content = bytearray(samples.finished(tmp_path / "run.mcap").read_bytes())
    content[len(content) // 2] ^= 255
    Path("damaged.mcap").write_bytes(content)
    Path("empty.csv").write_text("")
    Path("robot.csv").write_text("stamp,Fz,state\n0,1,a\n1,1,a\n")
    with pytest.raises(InputRefused) as refused:
        compare([Path(path) for path in paths], **options)
    assert expected in str(refused.value)
    assert len(str(refused.value).splitlines()) == 1


@pytest.mark.slow
def test_an_unfinished_run_is_compared_as_far_as_it_goes_and_says_so(
    position: Recording, tmp_path: Path, capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch
):
    monkeypatch.chdir(tmp_path)
    content = position.path.read_bytes()
    Path("half.mcap").write_bytes(content[: len(content) // 2])
    with pytest.raises(SystemExit) as ended:
        compare([position.path, Path("half.mcap")], signals=["plant.p_B"])
    assert ended.value.code == 1
    answer, *_, notes = capsys.readouterr().out.partition("\n")
    share = float(answer.split()[3])
    assert answer == f"B covers only {share:.3g} % of A's time, within the tolerance tube there"
    assert 30.0 < share < 60.0
    assert "plant.p_B[0]: B covers only a part of A; --partial" in " ".join(notes.split())
    assert "unfinished recording: read up to" in " ".join(notes.split())
    assert json.loads(Path("results/compare/compare.json").read_text())["covered"] == pytest.approx(
        share / 100, rel=0.01
    )
    compare([position.path, Path("half.mcap")], signals=["plant.p_B"], partial=True)
    assert f"within the tolerance tube of A: 3 signals, {share:.3g} % of A's time\n" in capsys.readouterr().out


def test_a_digitised_curve_is_judged_by_its_own_uncertainty(
    force_position: Recording, tmp_path: Path, capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch
):
    monkeypatch.chdir(tmp_path)
    t = np.linspace(0.5, 19.5, 60)
    F_z = np.interp(t, force_position.time("controller"), force_position["controller.F_z"])
    head = (
        '# [figure]\n# number = "0"\n# panel = "Z"\n# curve = "made for a test"\n# image = "none"\n'
        '# [digitised]\n# by = "a test"\n# on = 2026-01-31\n# tool = "none"\n'
        "# [calibration]\n# t_s = [[0, 0.0], [2000, 20.0]]\n# controller.F_z_N = [[900, 0.0], [100, 8.0]]\n"
        "# [uncertainty]\n# t_s = 0.05\n# controller.F_z_N = 0.2\n"
    )
    rows = {
        off: "".join(f"{time:.2f},{force + off:.3f}\n" for time, force in zip(t, F_z, strict=True))
        for off in (0.15, 0.3)
    }
    curve = Path("curve.csv")
    curve.write_text(f"{head}t_s,controller.F_z_N\n{rows[0.15]}")
    compare([force_position.path, curve], partial=True)
    assert "Fig. 0 Z, made for a test: digitised by a test on 2026-01-31" in capsys.readouterr().out
    curve.write_text(f"{head}t_s,controller.F_z_N\n{rows[0.3]}")
    with pytest.raises(SystemExit) as ended:
        compare([force_position.path, curve], partial=True)
    assert ended.value.code == 1
