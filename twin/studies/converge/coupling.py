"""Couplings of drives and plant, in the order of their complexity."""

from dataclasses import dataclass

from twin.kernel.cosim.interpolation import Inputs, Scheme
from twin.robot.experiment.experiment import Experiment, with_cosim


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
