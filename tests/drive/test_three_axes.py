"""Three axes in one FMI 3.0 FMU, as arrays."""

from pathlib import Path
from typing import Any

import numpy as np
import pytest
from numpy.typing import NDArray

from tests.drive.three_axes import three_axes_drive
from twin.cosim.component import Component
from twin.cosim.playback import columns, play
from twin.drive.component import FmuComponent
from twin.errors import InputRefused
from twin.experiment.schema import Drive
from twin.recording.reader import read
from twin.recording.recording import Recording
from twin.runs.assembly.drive_component import drive
from twin.runs.assembly.drives import planned
from twin.runs.assembly.load import load_experiment
from twin.runs.run import execute

Numbers = NDArray[np.float64]
SPEEDS, LOADS, ANGLES = np.array([1.0, 2.0, 4.0]), np.array([0.1, -0.3, 0.5]), np.array([0.2, 0.7, -0.4])
DROOP = 0.6
"""rad/s per N m, of three_axes.c."""


@pytest.fixture(scope="module")
def fmu(root: Path, tmp_path_factory: pytest.TempPathFactory) -> Path:
    return three_axes_drive(root, tmp_path_factory.mktemp("three_axes"))


def ran(root: Path, folder: Path, fmu: str, *overrides: str) -> Recording:
    folder.mkdir()
    experiment = load_experiment(root / "experiments/fig4_force_position.toml", ["duration_s=7", *overrides], fmu)
    return read(execute(experiment, folder).recording)


def test_three_axes_in_one_fmu_move_the_robot_like_three_drives(root: Path, fmu: Path, tmp_path: Path):
    together = ran(root, tmp_path / "together", str(fmu))
    apart = ran(root, tmp_path / "apart", "velocity_servo")
    assert together["drive.theta_m"].shape == (7001, 3)
    assert np.array_equal(together["controller.triggered"], apart["controller.triggered"])
    # the same solution written differently: rounding, which single encoder counts may pass on to the force
    assert np.abs(together["plant.p_B"] - apart["plant.p_B"]).max() < 1e-9
    assert np.array_equal(
        np.stack([together["drive.theta_m"][0, i] for i in range(3)]),
        np.stack([apart[f"drive/{i + 1}.theta_m"][0] for i in range(3)]),
    )


def stepped(component: Component, omega_ref: Numbers, tau_load: Numbers, ticks: int) -> dict[str, Numbers]:
    """Outputs (3,) after `ticks` of 1 ms with these inputs (3,)."""
    given = {"omega_ref": omega_ref, "tau_load": tau_load}
    u = np.tile(np.concatenate([given[port.name] for port in component.inputs]), (ticks, 1))
    rows, status = play(component, 1e-3 * np.arange(ticks, dtype=float), np.full(ticks, 1e-3), u)
    assert status == 0
    return {name: values[0] for name, values in columns(component, rows[-1:]).items()}


@pytest.mark.parametrize("plain", [{}, {"substeps": 2}], ids=["alone", "sub-stepped"])
def test_each_axis_has_its_own_command_load_and_angle(fmu: Path, plain: dict[str, Any]):
    """A robot in the plane x = 0 is its own mirror image and cannot tell axis 2 from axis 3."""
    component = drive("drive", planned(Drive.model_validate({"fmu": str(fmu), **plain})), 1e-3, ANGLES, LOADS)
    np.testing.assert_array_equal(component.initial("theta_m"), ANGLES)
    end = stepped(component, SPEEDS, LOADS, 1000)
    component.close()
    speed = SPEEDS - DROOP * LOADS
    # 50 time constants of 20 ms are over; on the way one of them was lost; rounding of 1,000 sums
    np.testing.assert_allclose(end["omega_m"], speed, rtol=1e-12)
    np.testing.assert_allclose(end["theta_m"] - ANGLES, speed * (1.0 - 0.02), rtol=1e-11)


def test_inside_the_fmu_axes_are_in_the_robots_order(fmu: Path):
    """Turned over on the way in and back on the way out nobody outside would see it."""
    component = drive("drive", planned(Drive.model_validate({"fmu": str(fmu)})), 1e-3, ANGLES, LOADS)
    assert isinstance(component, FmuComponent)
    variables = component.instance.description.variables
    np.testing.assert_array_equal(component.instance.read([variables["tau_load"]]), LOADS)
    stepped(component, SPEEDS, -LOADS, 1)
    found = component.instance.read([variables["omega_ref"], variables["tau_load"]])
    component.close()
    np.testing.assert_array_equal(found, [*SPEEDS, *-LOADS])


def test_a_joint_of_its_own_beside_three_axes_is_refused(root: Path, fmu: Path, tmp_path: Path):
    with pytest.raises(InputRefused, match="drives all three joints"):
        ran(root, tmp_path / "run", str(fmu), "drive.joint_2.fmu='fmus/ideal_velocity'")


def test_arrays_of_another_width_are_refused(root: Path, tmp_path: Path):
    fmu = str(three_axes_drive(root, tmp_path, size=2))
    with pytest.raises(InputRefused, match="omega_ref has 2, tau_load has 3"):
        ran(root, tmp_path / "run", fmu)


def test_three_axes_can_be_sub_stepped(root: Path, fmu: Path, tmp_path: Path):
    coarse, fine = ran(root, tmp_path / "a", str(fmu)), ran(root, tmp_path / "b", str(fmu), "drive.substeps=4")
    assert np.abs(coarse["plant.p_B"] - fine["plant.p_B"]).max() < 1e-9
