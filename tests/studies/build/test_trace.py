"""The same trace in another master: FMPy's slaves in a plain loop against the twin's own run, bit for bit."""

from collections.abc import Callable, Sequence
from pathlib import Path

import numpy as np
import pytest

from tests.studies.build.conftest import FIG4, ROOT
from tests.studies.build.loop import COMPUTER, PLANT, looped
from tests.studies.build.slaves import Slave
from twin.runs.assembly.load import load_experiment
from twin.runs.trace import Trace, run_in_memory

TICKS = 20_000
DRIVE = ROOT / "fmus" / "velocity_servo" / "velocity_servo.fmu"
JACOBI = ("cosim.scheme=jacobi", "controller.delay_ticks=1")
"""What a master in which all exchange their values between steps comes to: one tick of delay behind the controller."""


def own(settings: Sequence[str]) -> tuple[Trace, float]:
    """The twin's run of Fig. 4, and the droop of its drives."""
    experiment = load_experiment(FIG4, settings)
    droop = experiment.drives[0].parameters["droop"]
    assert isinstance(droop, float)
    return run_in_memory(experiment), droop


@pytest.mark.parametrize(
    ("fmi", "jacobi"),
    [("2.0", False), ("2.0", True), ("3.0", False), pytest.param("3.0", True, marks=pytest.mark.endurance)],
)
def test_fig4_in_a_plain_loop_is_the_twins_own_bit_for_bit(built: Callable[..., Path], fmi: str, jacobi: bool) -> None:
    run, droop = own(JACOBI if jacobi else ())
    theta_m = run.of_drives("theta_m")
    plant, computer = Slave(built("plant", fmi)).ready(), Slave(built("computer", fmi)).ready()
    true, believed, angles = looped(plant, computer, DRIVE, droop, theta_m[0], TICKS, jacobi)
    assert np.array_equal(angles, theta_m)
    for name in PLANT[:-1]:
        assert np.array_equal(true[name], run.held(name)), name
    # what is sampled is published at the end of the step
    assert np.array_equal(true["scale.F_z"][1:], run.held("scale.F_z")[:-1])
    for name in COMPUTER:
        assert np.array_equal(believed[name][:-1], run.held(name)[:-1]), name


def test_an_fmu_whose_stiffness_is_set_gives_the_trace_of_that_stiffness(built: Callable[..., Path]) -> None:
    run, droop = own(["plant.k_s_Nm_per_rad=1.2"])
    theta_m = run.of_drives("theta_m")
    plant = Slave(built("plant"), {"plant.k_s_Nm_per_rad": 1.2}, {"theta_m": theta_m[0]})
    # worked out natively, by Cramer's rule instead of LAPACK: some roundings of angles near 1 rad
    assert np.allclose(plant.get("plant.theta_m_rest"), theta_m[0], rtol=0.0, atol=1e-14)
    true, _, angles = looped(
        plant.ready(), Slave(built("computer")).ready(), DRIVE, droop, theta_m[0], TICKS, jacobi=False
    )
    assert np.array_equal(angles, theta_m)
    for name in PLANT[:-1]:
        assert np.array_equal(true[name], run.held(name)), name
