"""Once its code is there no command imports numba, which takes as long as a run; `twin build` compiles."""

import os
import shlex
import subprocess
import sys
from pathlib import Path

import pytest

pytestmark = pytest.mark.slow

REFUSAL = """import os
with open(os.environ["NUMBA_ASKED"], "a") as asked:
    asked.write("asked")
raise ImportError("numba is not to be imported")
"""
SWEEP = 'experiment = "step_z_air.toml"\n[[vary]]\nkey = "controller.position.kp_per_s"\nvalues = [1.0, 1.5]\n'
TOGETHER = (
    (
        "run fig4_force_position --isolate none --out a", "run fig4_position --isolate none --out b",
        "compare a b", "replay a --plant --out x", "export a --csv --rate 100", "report a --isolate none",
    ),
    ("run massage --isolate none --out a",),
    ("run calibration_one_pose --isolate none --out a", "identify a --out found"),
    ("faults pressing --kind surface_jump --onset 6 --isolate none",),
    ("converge step_z_air --duration 0.8 --isolate none",),
    ("analyse step_z_air --no-try --isolate none",),
    ("accuracy fig4_force_position --isolate none",),
    ("check step_z_air --drive velocity_servo --isolate none",),
    ("sweep sweep.toml -j 1 --out rows --yes", "sweep show rows"),
    ("tune step_z_air --isolate none",),
    ("drive check velocity_servo --isolate none", "component list", "doctor", "runs", "schema", "init new.toml"),
)  # fmt: skip


@pytest.mark.parametrize("lines", TOGETHER, ids=lambda lines: " ".join(lines[0].split()[:2]))
def test_no_command_imports_numba_once_its_code_is_there(tmp_path: Path, lines: tuple[str, ...]):
    (tmp_path / "numba").mkdir()
    (tmp_path / "numba" / "__init__.py").write_text(REFUSAL)
    asked = tmp_path / "asked"
    without = {**os.environ, "PYTHONPATH": str(tmp_path), "NUMBA_ASKED": str(asked)}
    for first in (True, False):
        folder = tmp_path / ("first" if first else "again")
        folder.mkdir()
        (folder / "sweep.toml").write_text(SWEEP)
        done = [ran(line, folder, without) for line in lines]
        if not asked.exists():
            break
        # something was not there yet: after it has been compiled, nothing has to be any more
        assert first, [process.stderr for process in done]
        asked.unlink()
        folder = tmp_path / "compiling"
        folder.mkdir()
        (folder / "sweep.toml").write_text(SWEEP)
        for line in lines:
            ran(line, folder, dict(os.environ))
    assert {process.returncode for process in done} <= {0, 1}, [process.stderr for process in done]
    assert "Traceback" not in "".join(process.stderr for process in done)


def ran(line: str, folder: Path, environment: dict[str, str]) -> subprocess.CompletedProcess[str]:
    """`twin LINE` in `folder`."""
    command = [sys.executable, "-m", "twin", *shlex.split(line)]
    return subprocess.run(command, cwd=folder, env=environment, capture_output=True, text=True)
