"""A checker of FMUs complains of an FMU that is not as it should be."""

from collections.abc import Callable
from pathlib import Path

import pytest

from tests.kernel.fmi.archives import redescribed
from validation.yardsticks.descriptions import fmpy_complaints, toolbox_complaints


@pytest.mark.parametrize("count", [fmpy_complaints, toolbox_complaints])
def test_a_name_that_is_there_twice_is_a_complaint(count: Callable[[Path], int], root: Path, tmp_path: Path):
    if count is toolbox_complaints:
        pytest.importorskip("fmu_manipulation_toolbox", reason="only make validation installs it")
    good = root / "fmus" / "velocity_servo" / "velocity_servo.fmu"
    assert count(good) == 0
    redescribed(good, tmp_path / "twice.fmu", 'name="omega_m"', 'name="theta_m"')
    assert count(tmp_path / "twice.fmu") > 0
