"""What couplings are compared with."""

from dataclasses import dataclass

import numpy as np

from twin.robot.assembly.assemble import assemble
from twin.robot.assembly.build import plant_parameters
from twin.robot.experiment.experiment import Experiment
from twin.studies.converge.coupling import FINEST_COUPLING
from twin.studies.converge.monolith import ATOL, has_monolithic_form, monolithic_rows, servos, within_limits
from twin.studies.converge.signals import FORCE_SIGNAL, Samples, largest_errors, sampled_run, signal_samples

FINE_STEPS = 32
"""The finest run's steps per tick of the experiment: 1/16 of the error of order two at an eighth of the tick."""


@dataclass(frozen=True)
class ReferenceRun:
    """samples: of the controller's ticks. floor: how far they may be off, by signal. meaning: where they come from."""

    samples: Samples
    floor: dict[str, float]
    meaning: str

    @property
    def is_pressing(self) -> bool:
        """Whether the robot presses on anything at any time."""
        return bool(np.any(self.samples[FORCE_SIGNAL.name]))


def reference_of(experiment: Experiment) -> ReferenceRun:
    """Without any coupling where the drives' equations are known, else the finest co-simulation."""
    with assemble(experiment) as assembly:
        drives = servos(assembly.drives)
    why = "no equations of this drive are known here"
    if drives is not None and not has_monolithic_form(experiment):
        why = "the monolithic one knows no moving bodies, delays, changes or dry friction"
    elif drives is not None:
        rows = monolithic_rows(experiment, drives)
        if within_limits(rows, drives):
            meaning = "monolithic: drives and plant as one equation"
            return ReferenceRun(signal_samples(rows, rows["theta_m"]), _solver_floor(experiment), meaning)
        why = "a drive reaches a limit"
    tick = experiment.cosim.tick
    finest, _ = sampled_run(FINEST_COUPLING.apply_to(experiment, tick / FINE_STEPS))
    coarser, _ = sampled_run(FINEST_COUPLING.apply_to(experiment, 2.0 * tick / FINE_STEPS))
    # of order two the finer one is off by a third of what it differs from the coarser one
    floor = {name: error / 3.0 for name, error in largest_errors(coarser, finest).items()}
    meaning = f"the finest run: {FINEST_COUPLING.name}, {1e3 * tick / FINE_STEPS:g} ms; {why}"
    return ReferenceRun(finest, floor, meaning)


def _solver_floor(experiment: Experiment) -> dict[str, float]:
    """The solver's tolerance of a position (m) or angle (rad), and what it is in a force and a torque."""
    tolerance = float(np.min(ATOL))
    p = plant_parameters(experiment.plant, experiment.contact)
    # bristle and surface together see an error of the position
    return {
        "F_z": p.K * tolerance,
        "p_B": tolerance,
        "theta_m": tolerance,
        "tau_load": p.k_s * (1.0 + p.N) * tolerance,
    }
