"""`twin component`: exit codes and what is printed."""

import json
from pathlib import Path

from tests.command_line import twin

EXAMPLE = "examples/my_controller.py:Controller"


def test_the_example_can_take_the_controllers_place(root: Path):
    done = twin("component", "check", "controller", EXAMPLE, "--set", "duration_s=1", cwd=root)
    assert done.returncode == 0, done.stderr
    assert done.stdout.splitlines()[-1] == "my_controller.py:Controller can take its place as controller"
    facts = json.loads(
        twin("component", "check", "controller", EXAMPLE, "--set", "duration_s=1", "--json", cwd=root).stdout
    )
    assert facts["good"] and facts["inputs"] == ["p_B", "J", "F_ee_B", "p_ref_B"]


def test_a_part_that_fails_is_exit_code_1_and_one_that_is_none_2(root: Path, tmp_path: Path):
    (tmp_path / "mine.py").write_text(
        "class Mine:\n    inputs = ()\n    outputs = ('omega_ref',)\n"
        "    def step(self, t, inputs):\n        return {'omega_ref': [float('inf')] * 3}\n"
    )
    asked = ("component", "check", "controller")
    done = twin(*asked, "mine.py:Mine", "--set", "duration_s=0.1", cwd=tmp_path)
    assert (done.returncode, "returned NaN or infinity for omega_ref" in done.stdout) == (1, True)
    done = twin(*asked, "mine.py:Yours", cwd=tmp_path)
    assert (done.returncode, done.stdout) == (2, "")
    assert "has no class 'Yours'; it has Mine" in done.stderr


def test_a_run_says_in_its_text_that_twins_own_did_not_run(root: Path, tmp_path: Path):
    named = ("--set", f"controller.python={root}/{EXAMPLE}", "--set", "duration_s=1")
    done = twin("run", root / "experiments/fig4_force_position.toml", *named, "--out", tmp_path / "x", cwd=root)
    assert done.returncode == 0, done.stderr
    assert "  controller my_controller.py:Controller (sha256 " in done.stdout
    report = twin("report", tmp_path / "x", cwd=root)
    assert report.returncode == 0, report.stderr
    assert "controller: my_controller.py:Controller" in (tmp_path / "x" / "report.html").read_text()
    assert "kp_mm_per_N" not in (tmp_path / "x" / "report.html").read_text()
