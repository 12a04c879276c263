"""A plant that its integrator cannot follow says so, and what it says to do helps."""

import re
from pathlib import Path

import numpy as np
import pytest

from tests.robot.plant.kinetic import mass_matrix
from twin.kernel.errors import ComponentFailed
from twin.robot.assembly.build import plant_parameters
from twin.robot.assembly.load import load_experiment
from twin.robot.experiment.experiment import Experiment
from twin.robot.mechanism.geometry import geometry_of
from twin.robot.mechanism.kinematics import jacobian, joint_angles
from twin.robot.run.fastest_pole import STABLE, fastest_pole, too_fast
from twin.robot.run.run import execute


def stiff(root: Path, *settings: str) -> Experiment:
    return load_experiment(root / "experiments/fig4_force_position.toml", ["duration_s=0.2", *settings])


def test_the_pole_of_friction_alone_is_damping_over_inertia(root: Path):
    """Far above all springs the poles are the eigenvalues of M^-1 b_j J^T J, with M of uniform rods: (P6)."""
    experiment = stiff(root, "plant.b_j_Nm_s_per_rad=200", "plant.eta_rate_rad_per_s=0")
    geometry = geometry_of(experiment.plant)
    J = jacobian(geometry, experiment.start)
    M = mass_matrix(plant_parameters(experiment.plant, experiment.contact), joint_angles(geometry, experiment.start), J)
    expected = np.linalg.eigvals(np.linalg.solve(M, 200.0 * J.T @ J)).real.max()
    # the springs are 1e-4 of it
    assert fastest_pole(experiment) == pytest.approx(expected, rel=1e-3)


@pytest.mark.parametrize("settings", [[], ["contact.body=back", "contact.height_mm=-100"]])
def test_the_shipped_plants_are_slow_enough(root: Path, settings: list[str]):
    assert too_fast(stiff(root, *settings)) == ""


def test_friction_that_is_too_stiff_for_the_tick_names_the_substeps_that_help(root: Path, tmp_path: Path):
    friction = "plant.b_j_Nm_s_per_rad=20"
    (tmp_path / "a").mkdir()
    (tmp_path / "b").mkdir()
    with pytest.raises(ComponentFailed, match=r"fastest pole is about 6.3e\+04 1/s") as failed:
        execute(stiff(root, friction), tmp_path / "a")
    substeps = re.search(r"set \[plant\] substeps = (\d+)", str(failed.value))
    assert substeps
    execute(stiff(root, friction, f"plant.substeps={substeps[1]}"), tmp_path / "b")


def test_a_plant_whose_numbers_are_absurd_blames_neither_drive_nor_tick(root: Path, tmp_path: Path):
    with pytest.raises(ComponentFailed) as failed:
        execute(stiff(root, "plant.m_p_g=1e308"), tmp_path)
    assert "stiffness, mass or damping that is absurd" in str(failed.value)
    assert "drive check" not in str(failed.value)


def test_the_limit_is_that_of_classical_runge_kutta():
    """|1 + z + z^2/2 + z^3/6 + z^4/24| <= 1 up to 2.785 on the negative real axis, 2.828 on the imaginary one."""

    def growth(z: complex) -> float:
        return abs(1 + z + z**2 / 2 + z**3 / 6 + z**4 / 24)

    assert growth(-STABLE) <= 1.0 and growth(1j * STABLE) <= 1.0
    assert growth(-STABLE * 1.04) > 1.0 and growth(1j * STABLE * 1.05) > 1.0
    assert np.isclose(growth(-2.785293563), 1.0, atol=1e-6)
