from pathlib import Path

import pytest

from benchmarks.c_loop import CLoop, NoCompiler
from benchmarks.macro_step import refuse_different_results
from twin.robot.assembly.drives import plan_drive
from twin.robot.experiment.drive_files import load_drive


def test_the_yardstick_reads_the_memory_of_a_drive_as_it_is_and_computes_the_same_bits(root: Path, tmp_path: Path):
    try:
        loop = CLoop(tmp_path)
    except NoCompiler as problem:
        pytest.skip(str(problem))
    refuse_different_results(plan_drive(load_drive(str(root / "fmus" / "velocity_servo"), root / "fmus")), loop)
