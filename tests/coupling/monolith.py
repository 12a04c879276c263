"""The monolithic reference in terms of python-control, and by label.

`coupled_system` says what is integrated; `coupled_derivative` of `twin.studies.converge.monolith` is the same compiled,
which makes 20 s of it affordable, and `test_monolith.py` holds the two together.
"""

from dataclasses import replace

import control
import numpy as np
from numpy.typing import NDArray

from twin.robot.assembly.assemble import assemble
from twin.robot.assembly.build import plant_parameters
from twin.robot.experiment.experiment import Experiment
from twin.robot.plant.component import PLANT_OUTPUTS
from twin.studies.analyse.linear.hand import plant_system, signal_labels
from twin.studies.converge.monolith import has_monolithic_form, monolithic_rows, servos, within_limits

LEGS = (1, 2, 3)
T_M = 0.020
"""Default of velocity_servo.fmu (s)."""


def drive_droop(experiment: Experiment) -> NDArray[np.float64]:
    """The three drives' droop (3,), rad/s per N m: the only parameter that the experiments set."""
    return np.array([drive.parameters["droop"] for drive in experiment.drives])


def velocity_servos(T_m: float, droop: NDArray[np.float64]) -> control.StateSpace:
    """T_m d omega_m/dt = omega_ref - droop tau_load - omega_m per leg: velocity_servo.fmu with its limits out of reach.

    States theta_m_1 .. 3, omega_m_1 .. 3. One system of three, because `control.interconnect` pays per system.
    """
    O, I = np.zeros((3, 3)), np.eye(3)
    return control.ss(
        np.block([[O, I], [O, -I / T_m]]),
        np.block([[O, O], [I / T_m, -np.diag(droop) / T_m]]),
        np.block([I, O]),
        np.zeros((3, 6)),
        inputs=[f"{signal}_{leg}" for signal in ("omega_ref", "tau_load") for leg in LEGS],
        outputs=[f"theta_m_{leg}" for leg in LEGS],
        name="drives",
    )


def coupled_system(experiment: Experiment) -> control.InterconnectedSystem:
    """Three drives and the plant, inputs omega_ref_1 .. 3, outputs those of the plant and theta_m_1 .. 3."""
    drives = velocity_servos(T_M, drive_droop(experiment))
    plant = plant_system(plant_parameters(experiment.plant, experiment.contact))
    return control.interconnect(
        [drives, plant],
        inputs=[f"omega_ref_{leg}" for leg in LEGS],
        outputs=[*plant.output_labels, *drives.output_labels],
    )


def monolithic_run(experiment: Experiment, duration: float) -> dict[str, NDArray[np.float64]]:
    """`monolithic_rows` of the shipped drives from 0 to `duration` (s), one value per label."""
    experiment = replace(experiment, duration_ticks=round(duration / experiment.cosim.tick))
    with assemble(experiment) as assembly:
        drives = servos(assembly.drives)
    assert drives is not None and has_monolithic_form(experiment)
    rows = monolithic_rows(experiment, drives)
    assert within_limits(rows, drives)
    values = np.concatenate([rows[f"plant.{port.name}"] for port in PLANT_OUTPUTS], axis=1)
    return dict(zip(signal_labels(PLANT_OUTPUTS), values.T, strict=True))
