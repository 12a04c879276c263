"""A drive of one's own, as docs/drives.md makes one: two files, one command, and it is a drive like the others."""

import importlib.util
import shutil
import subprocess
import sys
from pathlib import Path

import pytest

from tests.docs.code_blocks import blocks
from twin.robot.assembly.drives import plan_drive
from twin.robot.experiment.drive_files import load_drive

NAME = "lag_servo"

pytestmark = pytest.mark.skipif(importlib.util.find_spec("ziglang") is None, reason="drives are built with ziglang")


@pytest.fixture
def workshop(root: Path, tmp_path: Path) -> Path:
    """A copy of what builds drives, with the files of the page."""
    fmus = tmp_path / "fmus"
    fmus.mkdir()
    for name in ("builder", "fmi2", "fmi3"):
        shutil.copytree(root / "fmus" / name, fmus / name)
    for name in ("build.py", "references.toml"):
        shutil.copy(root / "fmus" / name, fmus / name)
    files = [block for block in blocks(root, "docs/drives.md") if block.file_name.startswith(f"fmus/{NAME}/")]
    assert {Path(block.file_name).name for block in files} == {"model.c", "drive.toml"}
    (fmus / NAME).mkdir()
    for block in files:
        (tmp_path / block.file_name).write_text(block.text)
    return tmp_path


def built(workshop: Path) -> subprocess.CompletedProcess[str]:
    return subprocess.run(
        [sys.executable, "fmus/build.py", NAME], cwd=workshop, capture_output=True, text=True, timeout=600
    )


@pytest.mark.endurance  # the C compiler's library for Windows alone takes a minute and a half to make
def test_the_drive_of_the_page_is_built_and_fits(workshop: Path):
    done = built(workshop)
    assert (done.returncode, done.stdout) == (0, f"fmus/{NAME}/{NAME}.fmu\n"), done.stderr
    plan = plan_drive(load_drive(str(workshop / "fmus" / NAME), workshop))
    assert {binding.role.port.name for binding in plan.bindings} >= {"omega_ref", "tau_load", "theta_m", "omega_m"}


def test_what_the_compiler_refuses_ends_with_what_it_says(workshop: Path):
    model = workshop / "fmus" / NAME / "model.c"
    model.write_text(model.read_text().replace("v->tau_load", "v->tau_laod"))
    done = built(workshop)
    assert done.returncode == 1 and "tau_laod" in done.stderr and "Traceback" not in done.stderr
    assert done.stderr.endswith(f"drive '{NAME}' was not built\n")
