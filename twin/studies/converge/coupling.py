"""The ways in which drives and plant may exchange their values, from the simplest on."""

from dataclasses import dataclass

from twin.kernel.cosim.interpolation import Inputs, Scheme
from twin.robot.experiment.experiment import Experiment, with_cosim


@dataclass(frozen=True)
class Coupling:
    """Scheme, inputs and iterations of `twin.kernel.cosim.system.System`."""

    scheme: Scheme
    inputs: Inputs
    iterations: int = 1

    @property
    def name(self) -> str:
        """In the words of [cosim]; "2 times": iterations = 2."""
        again = f", {self.iterations} times" if self.iterations > 1 else ""
        return f"{self.scheme}, {self.inputs}{again}"

    @property
    def expected_order(self) -> int:
        """Where everything is smooth: the error of a value held from one end, or of the middle of a line."""
        return 1 if self.inputs == "hold" else 2

    def apply_to(self, experiment: Experiment, tick: float) -> Experiment:
        """`experiment` coupled so at `tick` (s)."""
        return with_cosim(experiment, tick=tick, scheme=self.scheme, inputs=self.inputs, iterations=self.iterations)


COUPLINGS = (
    Coupling("gauss_seidel", "hold"),
    Coupling("jacobi", "hold"),
    Coupling("gauss_seidel", "linear"),
    Coupling("jacobi", "linear"),
    Coupling("gauss_seidel", "linear", iterations=2),
)
FINEST_COUPLING = Coupling("gauss_seidel", "linear")
"""The most accurate one that every drive can."""
