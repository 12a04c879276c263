"""The script for SLURM, with `srun` played by a command that runs what it is told to on this machine."""

import os
import subprocess
import sys
from pathlib import Path

import pytest

SWEEP = """
experiment = "{root}/experiments/step_z_air.toml"
design = "grid"
[[vary]]
key = "controller.position.kp_per_s"
values = [1.0, 1.5, 2.0]
"""


@pytest.mark.endurance
def test_the_script_runs_a_sweep(root: Path, tmp_path: Path):
    pytest.importorskip("distributed")
    programs = {"srun": "", "twin": f"{sys.executable} -m twin", "python": sys.executable,
                "dask": f"{sys.executable} -m dask"}  # fmt: skip
    (tmp_path / "programs").mkdir()
    for name, starts in programs.items():
        (tmp_path / "programs" / name).write_text(f'#!/bin/sh\nexec {starts} "$@"\n')
        (tmp_path / "programs" / name).chmod(0o755)
    (tmp_path / "s.toml").write_text(SWEEP.format(root=root))
    environment = os.environ | {
        "PATH": f"{tmp_path / 'programs'}:{os.environ['PATH']}", "PYTHONPATH": str(root),
        "SLURM_JOB_ID": "7", "SLURM_CPUS_PER_TASK": "2", "SLURM_NNODES": "1",
    }  # fmt: skip
    command = ["bash", str(root / "examples/sweep.slurm"), "s.toml"]
    done = subprocess.run(command, cwd=tmp_path, env=environment, capture_output=True, text=True, timeout=200)
    assert done.returncode == 0, done.stderr
    assert "s  3 runs: " in done.stdout
