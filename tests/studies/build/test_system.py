"""The exported parts as a system of an SSP, in the twin's own master: the run they were taken from, bit for bit."""

from collections.abc import Callable
from pathlib import Path

import numpy as np
import pytest

from tests.studies.build.loop import COMPUTER, PLANT
from tests.studies.build.system import LEGS, fig4
from tests.studies.build.test_trace import JACOBI, own
from twin.recording.reader import read
from twin.runs.guard.reporter import DirectReporter
from twin.studies.systems.study import recorded_system


@pytest.mark.parametrize("jacobi", [False, True])
def test_fig4_as_an_ssp_is_the_twins_own_bit_for_bit(built: Callable[..., Path], tmp_path: Path, jacobi: bool) -> None:
    run, droop = own(JACOBI if jacobi else ())
    theta_m = run.of_drives("theta_m")
    file = fig4(tmp_path / "fig4.ssp", built, droop, theta_m[0])
    came = recorded_system(
        DirectReporter(lambda note: None), str(file), scheme="jacobi" if jacobi else "gauss_seidel",
        out=str(tmp_path / "run"),
    )["facts"]  # fmt: skip
    assert came["settled"] and came["tick_s"] == 0.001 and not came["kept"]
    found = read(tmp_path / "run" / "run.mcap")
    angles = np.column_stack([found[f"drive_{i}.theta_m"] for i in LEGS])
    assert np.array_equal(angles + theta_m[0], theta_m)
    for name in PLANT[:-1]:
        assert found[name].tobytes() == run.held(name).tobytes(), name
    # what is sampled is published at the end of the step
    assert np.array_equal(found["plant.scale_F_z"][1:], run.held("scale.F_z")[:-1])
    for name in COMPUTER:
        assert np.array_equal(found[f"computer.{name.replace('.', '_')}"][1:], run.held(name)[:-1]), name
