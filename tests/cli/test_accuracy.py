import json
from pathlib import Path

import pytest

from tests.command_line import twin

POSITION = "experiments/fig4_position.toml"
PRESS = ("reference.p_mm=[[0,0,-101],[0,0,-104],[0,0,-104]]", "reference.t_s=[0,0.5,3]", "duration_s=3")
"""From the surface 3 mm into it."""
SETTINGS = [word for text in PRESS for word in ("--set", text)]


@pytest.mark.slow
def test_the_error_is_printed_first_and_where_the_facts_are_last(root: Path, tmp_path: Path):
    done = twin("accuracy", root / POSITION, *SETTINGS, cwd=tmp_path)
    assert done.returncode == 0, done.stderr
    lines = done.stdout.splitlines()
    assert lines[0].startswith("fig4_position: the force is estimated to 0.")
    assert max(map(len, lines)) <= 80
    facts = json.loads((tmp_path / lines[-1].split()[1]).read_text())
    assert f"{facts['contributions'][-1]['rms_N']:.3f} N rms" in lines[0]


@pytest.mark.slow
def test_a_report_with_a_budget_has_its_table(root: Path, tmp_path: Path):
    assert twin("run", root / POSITION, *SETTINGS, "--out", "mine", cwd=tmp_path).returncode == 0
    done = twin("report", "mine", "--budget", cwd=tmp_path)
    assert done.returncode == 0, done.stderr
    facts = json.loads(twin("accuracy", root / POSITION, *SETTINGS, "--json", cwd=tmp_path).stdout)
    page = (tmp_path / "mine" / "report.html").read_text()
    for line in facts["contributions"]:
        assert f"<td>{line['rms_N']:.4f}</td>" in page


@pytest.mark.parametrize(
    ("arguments", "said"),
    [
        (("experiments/step_z_air.toml",), "step_z_air: presses with 0.5 N at most"),
        (("experiments/tapping.toml",), "tapping: taps turn at the measured force"),
        ((POSITION, "--drive", "no_such_drive"), "no such drive"),
    ],
)
def test_what_has_no_budget_is_refused_in_one_sentence(
    root: Path, tmp_path: Path, arguments: tuple[str, ...], said: str
):
    done = twin("accuracy", root / arguments[0], *arguments[1:], cwd=tmp_path)
    assert done.returncode == 2
    assert said in done.stderr and len(done.stderr.splitlines()) == 1
