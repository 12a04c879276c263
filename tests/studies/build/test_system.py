"""The exported parts as a system of an SSP, in the twin's own master: the run they were taken from, bit for bit."""

from collections.abc import Callable
from pathlib import Path

import numpy as np
import pytest

from tests.studies.build.loop import COMPUTER, PLANT
from tests.studies.build.test_trace import DRIVE, JACOBI, own
from tests.studies.systems.archives import archive, component, connection, connector, line, structure, system, values
from twin.recording.reader import read
from twin.runs.guard.reporter import DirectReporter
from twin.studies.systems.study import recorded_system

LEGS = (1, 2, 3)


def fig4(file: Path, built: Callable[..., Path], droop: float, theta_m: np.ndarray, stop: float = 20.0) -> Path:
    """Fig. 4 as an SSP: computer, drives, plant; a drive counts from its own zero."""
    wires = []
    for i, zero in zip(LEGS, theta_m, strict=True):
        shift = line(offset=repr(float(zero)))
        wires += [
            connection(f"computer.controller.omega_ref[{i}]", f"drive_{i}.omega_ref"),
            connection(f"plant.plant.tau_load[{i}]", f"drive_{i}.tau_load"),
            connection(f"drive_{i}.theta_m", f"plant.theta_m[{i}]", shift),
            connection(f"drive_{i}.theta_m", f"computer.theta_m[{i}]", shift),
            connection(f"plant.plant.theta_l[{i}]", f"computer.theta_l[{i}]"),
        ]
    speed = connector("omega_ref", "input", "rad/s")
    parts = [
        component("computer", "resources/computer.fmu"),
        *(component(f"drive_{i}", "resources/drive.fmu", [speed], values(f"droop={droop!r}")) for i in LEGS),
        component("plant", "resources/plant.fmu"),
    ]
    resources = {"computer": built("computer"), "drive": DRIVE, "plant": built("plant")}
    return archive(
        file,
        structure(system(parts, wires), stop),
        {f"resources/{name}.fmu": path for name, path in resources.items()},
    )


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
