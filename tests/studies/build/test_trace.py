"""The same trace in another master: FMPy's slaves in a plain loop against the twin's own run, bit for bit."""

from collections.abc import Callable, Sequence
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from tests.studies.build.conftest import DELAYED, FIG4, MASSAGE, ROOT
from tests.studies.build.loop import differing, looped
from tests.studies.build.slaves import Slave
from twin.robot.assembly.load import load_experiment
from twin.robot.run.trace import Trace, run_in_memory

DRIVE = ROOT / "fmus" / "velocity_servo" / "velocity_servo.fmu"
JACOBI = ("cosim.scheme=jacobi", "controller.bus_delay_ticks=1")
"""What a master in which all exchange their values between steps comes to: one tick of delay behind the computer."""
RUNAWAY = ('fault=[{kind="drive_runaway", target="drive_2", onset_s=0.4, magnitude_rad_per_s=8.0}]',)


def own(experiment: Path, settings: Sequence[str], ticks: int, jacobi: bool) -> tuple[Trace, float]:
    """The twin's run of an experiment, and the droop of its drives."""
    loaded = replace(load_experiment(experiment, [*settings, *(JACOBI if jacobi else ())]), duration_ticks=ticks)
    droop = loaded.drives[0].parameters["droop"]
    assert isinstance(droop, float)
    return run_in_memory(loaded), droop


@pytest.mark.parametrize(
    ("fmi", "jacobi"),
    [("2.0", False), ("2.0", True), ("3.0", False), pytest.param("3.0", True, marks=pytest.mark.endurance)],
)
def test_fig4_in_a_plain_loop_is_the_twins_own_bit_for_bit(built: Callable[..., Path], fmi: str, jacobi: bool) -> None:
    run, droop = own(FIG4, (), 20_000, jacobi)
    plant, computer = Slave(built("plant", fmi)).ready(), Slave(built("computer", fmi)).ready()
    signals = looped(plant, computer, DRIVE, droop, run.of_drives("theta_m")[0], 20_000, jacobi)
    assert differing(signals, run) == []


def massaged(
    built: Callable[..., Path], computer: tuple[str, ...], ticks: int, jacobi: bool, fault: tuple[str, ...] = ()
) -> list[str]:
    """Signals that differ in a massage; `computer`: settings of it, `fault`: of what breaks the second drive."""
    run, droop = own(MASSAGE, (*computer, *fault), ticks, jacobi)
    plant, whole = (
        Slave(built("plant", "2.0", (), str(MASSAGE))),
        Slave(built("computer", "2.0", computer, str(MASSAGE))),
    )
    behind = Slave(built("fault_1", "2.0", fault, str(MASSAGE))).ready() if fault else None
    theta_m = run.of_drives("theta_m")[0]
    signals = looped(
        plant.ready(), whole.ready(), DRIVE, droop, theta_m, ticks, jacobi, "monitor.omega_ref", behind
    )  # fmt: skip
    assert np.ptp(signals["monitor.utilisation"]) > 0.0
    assert np.ptp(signals["monitor.power"]) == bool(fault)
    return differing(signals, run)


@pytest.mark.parametrize("jacobi", [False, True])
def test_with_a_monitor_it_is_so_too(built: Callable[..., Path], jacobi: bool) -> None:
    assert massaged(built, DELAYED, 1500, jacobi) == []


@pytest.mark.endurance
@pytest.mark.parametrize("jacobi", [False, True])
def test_a_whole_massage_is_the_twins_own_bit_for_bit(built: Callable[..., Path], jacobi: bool) -> None:
    assert massaged(built, (), 62_000, jacobi) == []


@pytest.mark.parametrize("jacobi", [False, True])
def test_a_fault_is_a_part_that_loses_its_power_as_in_the_twin(built: Callable[..., Path], jacobi: bool) -> None:
    assert massaged(built, DELAYED, 1500, jacobi, RUNAWAY) == []


def test_an_fmu_whose_stiffness_is_set_gives_the_trace_of_that_stiffness(built: Callable[..., Path]) -> None:
    run, droop = own(FIG4, ["plant.k_s_Nm_per_rad=1.2"], 20_000, jacobi=False)
    theta_m = run.of_drives("theta_m")[0]
    plant = Slave(built("plant"), {"plant.k_s_Nm_per_rad": 1.2}, {"theta_m": theta_m})
    # worked out natively, by Cramer's rule instead of LAPACK: some roundings of angles near 1 rad
    assert np.allclose(plant.get("plant.theta_m_rest"), theta_m, rtol=0.0, atol=1e-14)
    signals = looped(plant.ready(), Slave(built("computer")).ready(), DRIVE, droop, theta_m, 20_000, jacobi=False)
    assert differing(signals, run) == []
