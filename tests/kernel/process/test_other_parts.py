"""A Python class of somebody that never returns costs no more than its run."""

from pathlib import Path

import pytest

from tests.laws.runs import EXPERIMENTS, FORCE
from twin.kernel.errors import TwinError
from twin.kernel.process.guard import run_guarded
from twin.kernel.process.job import JobLimits

JOB = "twin.robot.live.runs:recorded_runs"
CLASS = """
class Controller:
    inputs = ("p_B",)
    outputs = ("omega_ref",)

    def step(self, t, inputs):
        while t > 0.05:
            pass
        return {"omega_ref": [0.0, 0.0, 0.0]}
"""


@pytest.mark.slow
@pytest.mark.parametrize(
    ("text", "said", "exit_code"),
    [
        (CLASS, r"mine.py:Controller \(controller\) did not return within 1 s at t = 0.052 s", 3),
        ("while True: pass", r"mine.py \(controller\) did not return within 1 s in its import", 2),
    ],
)
def test_a_class_that_does_not_return_is_named(tmp_path: Path, text: str, said: str, exit_code: int):
    (tmp_path / "mine.py").write_text(text)
    asked = {
        "experiments": [str(EXPERIMENTS / f"{FORCE}.toml")], "drive": None, "body": None,
        "settings": ["duration_s=0.1", f"controller.python={tmp_path}/mine.py:Controller"], "out": str(tmp_path / "x"),
    }  # fmt: skip
    with pytest.raises(TwinError, match=said) as ended:
        run_guarded(JOB, asked, JobLimits(step=1.0))
    assert ended.value.exit_code == exit_code
