from pathlib import Path

import pytest

from tests.command_line import twin
from tests.kernel.process.hostile import SEGFAULT, hostile_drive

EXPERIMENT = "experiments/fig4_force_position.toml"


@pytest.fixture(scope="module")
def crashing(root: Path, tmp_path_factory: pytest.TempPathFactory) -> Path:
    return hostile_drive(root, tmp_path_factory.mktemp("crashing"))


@pytest.mark.parametrize("command", ["accuracy", "converge"])
def test_a_drive_that_crashes_ends_the_command_with_a_sentence(
    root: Path, tmp_path: Path, crashing: Path, command: str
):
    settings = [f"drive.joint_2.fmu='{crashing}'", f"drive.joint_2.parameters.droop={SEGFAULT}"]
    flags = [word for setting in settings for word in ("--set", setting)]
    done = twin(command, root / EXPERIMENT, *flags, cwd=tmp_path, isolated=True)
    assert done.returncode == 3
    assert done.stderr.startswith("hostile.fmu (drive_2) crashed (SIGSEGV, segmentation fault) in the step from t = ")
    assert "`--isolate none` runs it under a debugger" in done.stderr and len(done.stderr.splitlines()) == 1
