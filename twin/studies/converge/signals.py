"""Compared signals: both sides of the coupling, and the pressing force."""

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from twin.kernel.cosim.observers import simulate
from twin.robot.assembly.assemble import assemble
from twin.robot.experiment.experiment import Experiment
from twin.robot.run.trace import Trace

Samples = dict[str, NDArray[np.float64]]
"""Samples by signal, (n, values): one row per tick of the controller."""


@dataclass(frozen=True)
class Signal:
    """A compared signal of a coupling study: name as in recordings, displayed unit, displayed units per SI unit."""

    name: str
    unit: str
    scale: float = 1.0


COMPARED_SIGNALS = (
    Signal("F_z", "mN", 1e3),
    Signal("p_B", "um", 1e6),
    Signal("theta_m", "urad", 1e6),
    Signal("tau_load", "uN m", 1e6),
)
FORCE_SIGNAL, POSITION_SIGNAL = COMPARED_SIGNALS[:2]


def signal_samples(plant: Samples, theta_m: NDArray[np.float64]) -> Samples:
    """Extract the compared signals from the plant's outputs and the motor angles (n, 3)."""
    return {
        "F_z": -plant["plant.F_ee_B"][:, 2:],
        "p_B": plant["plant.p_B"],
        "theta_m": theta_m,
        "tau_load": plant["plant.tau_load"],
    }


def sampled_run(experiment: Experiment) -> tuple[Samples, float]:
    """Run an experiment in this process; return its compared signals and the wall time per simulated time."""
    run = Trace(experiment.controller_ticks)
    with assemble(experiment) as assembly:
        done = simulate(assembly, experiment.duration_ticks, [run]).require_success()
    plant = {key: run[key] for key in ("plant.F_ee_B", "plant.p_B", "plant.tau_load")}
    simulated = experiment.duration_ticks * experiment.cosim.tick
    return signal_samples(plant, run.of_drives("theta_m")), done.stepping / simulated


def largest_errors(samples: Samples, reference: Samples) -> dict[str, float]:
    """Return the largest absolute difference to the reference for each signal, over all values and times."""
    return {name: float(np.abs(values - reference[name]).max()) for name, values in samples.items()}
