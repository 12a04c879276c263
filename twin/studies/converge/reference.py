"""Couplings of drives and plant in the order of their complexity, and the reference run that judges them."""

from dataclasses import dataclass

import numpy as np

from twin.kernel.cosim.interpolation import Inputs, Scheme
from twin.robot.assembly.assemble import assemble
from twin.robot.assembly.build import plant_parameters
from twin.robot.experiment.experiment import Experiment, with_cosim
from twin.studies.converge.monolith import ATOL, has_monolithic_form, monolithic_rows, servos, within_limits
from twin.studies.converge.signals import FORCE_SIGNAL, Samples, largest_errors, sampled_run, signal_samples

FINE_STEPS = 32
"""Steps of the finest run per tick of the experiment: 1/16 of the error of order two at an eighth of the tick."""


@dataclass(frozen=True)
class Coupling:
    """A coupling of drives and plant: scheme, input mode and iterations of the co-simulation."""

    scheme: Scheme
    inputs: Inputs
    iterations: int = 1

    @property
    def name(self) -> str:
        """Name of the coupling in the terms of [cosim]; "2 times" stands for iterations = 2."""
        again = f", {self.iterations} times" if self.iterations > 1 else ""
        return f"{self.scheme}, {self.inputs}{again}"

    @property
    def expected_order(self) -> int:
        """Expected order of the coupling error for smooth signals: 1 for held inputs, 2 for linear ones."""
        return 1 if self.inputs == "hold" else 2

    def apply_to(self, experiment: Experiment, tick: float) -> Experiment:
        return with_cosim(experiment, tick=tick, scheme=self.scheme, inputs=self.inputs, iterations=self.iterations)


COUPLINGS = (
    Coupling("gauss_seidel", "hold"),
    Coupling("jacobi", "hold"),
    Coupling("gauss_seidel", "linear"),
    Coupling("jacobi", "linear"),
    Coupling("gauss_seidel", "linear", iterations=2),
)
FINEST_COUPLING = Coupling("gauss_seidel", "linear")
"""The most accurate coupling that every drive supports."""


@dataclass(frozen=True)
class ReferenceRun:
    """Reference run of a coupling study: samples at the controller's ticks, accuracy by signal, origin."""

    samples: Samples
    floor: dict[str, float]
    meaning: str

    @property
    def is_pressing(self) -> bool:
        return bool(np.any(self.samples[FORCE_SIGNAL.name]))


def reference_of(experiment: Experiment) -> ReferenceRun:
    """Run the reference of a coupling study: one differential equation if possible, else the finest co-simulation."""
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
    # Richardson: for order two the error of the finer run is a third of its difference from the coarser one
    floor = {name: error / 3.0 for name, error in largest_errors(coarser, finest).items()}
    meaning = f"the finest run: {FINEST_COUPLING.name}, {1e3 * tick / FINE_STEPS:g} ms; {why}"
    return ReferenceRun(finest, floor, meaning)


def _solver_floor(experiment: Experiment) -> dict[str, float]:
    """Return the accuracy of the reference's solver: for positions (m), angles (rad), force and torque."""
    tolerance = float(np.min(ATOL))
    p = plant_parameters(experiment.plant, experiment.contact)
    # upper bound: bristle and surface in series respond to an error of the position
    return {
        "F_z": p.K * tolerance,
        "p_B": tolerance,
        "theta_m": tolerance,
        "tau_load": p.k_s * (1.0 + p.N) * tolerance,
    }
