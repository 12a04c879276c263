"""Three axes in one FMI 3.0 FMU, as arrays."""

from pathlib import Path

import numpy as np
import pytest

from tests.drive.three_axes import three_axes_drive
from twin.errors import InputRefused
from twin.execution import execute
from twin.experiment.experiment import load_experiment
from twin.recording.reader import read
from twin.recording.recording import Recording


def ran(root: Path, folder: Path, fmu: str, *overrides: str) -> Recording:
    folder.mkdir()
    experiment = load_experiment(root / "experiments/fig4_force_position.toml", ["duration_s=7", *overrides], fmu)
    return read(execute(experiment, folder).recording)


def test_three_axes_in_one_fmu_move_the_robot_like_three_drives(root: Path, tmp_path: Path):
    together = ran(root, tmp_path / "together", str(three_axes_drive(root, tmp_path)))
    apart = ran(root, tmp_path / "apart", "velocity_servo")
    assert together["drive.theta_m"].shape == (7001, 3)
    assert np.array_equal(together["controller.triggered"], apart["controller.triggered"])
    # the same solution written differently: rounding, which single encoder counts may pass on to the force
    assert np.abs(together["plant.p_B"] - apart["plant.p_B"]).max() < 1e-9
    assert np.array_equal(
        np.stack([together["drive.theta_m"][0, i] for i in range(3)]),
        np.stack([apart[f"drive/{i + 1}.theta_m"][0] for i in range(3)]),
    )


def test_a_joint_of_its_own_beside_three_axes_is_refused(root: Path, tmp_path: Path):
    fmu = str(three_axes_drive(root, tmp_path))
    with pytest.raises(InputRefused, match="drives all three joints"):
        ran(root, tmp_path / "run", fmu, "drive.joint_2.fmu='fmus/ideal_velocity'")


def test_arrays_of_another_width_are_refused(root: Path, tmp_path: Path):
    fmu = str(three_axes_drive(root, tmp_path, size=2))
    with pytest.raises(InputRefused, match="omega_ref has 2, tau_load has 3"):
        ran(root, tmp_path / "run", fmu)


def test_three_axes_can_be_sub_stepped(root: Path, tmp_path: Path):
    fmu = str(three_axes_drive(root, tmp_path))
    coarse, fine = ran(root, tmp_path / "a", fmu), ran(root, tmp_path / "b", fmu, "drive.substeps=4")
    assert np.abs(coarse["plant.p_B"] - fine["plant.p_B"]).max() < 1e-9
