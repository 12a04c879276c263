"""A model-exchange FMU as a component: its equations, a solver of ours, and a step like any other's."""

from collections.abc import Mapping, Sequence
from pathlib import Path

import numpy as np

from twin.cosim.rewind import Rewind, joined_rewind, record_rewind
from twin.drive.component import FmuComponent, FmuPort
from twin.drive.description import FmuDescription
from twin.drive.exchange.integrator import Integrator
from twin.drive.exchange.model import Model
from twin.drive.exchange.solver import Solver
from twin.drive.instance import Setting, Setup


class ExchangeComponent(FmuComponent):
    """One model-exchange FMU and its solver as a continuous component.

    Args:
        solver: which; all others are those of `FmuComponent`.

    Raises:
        InputRefused: as `FmuComponent`, or there is no CVODE for this platform.
    """

    _integrator: Integrator | None = None

    def __init__(
        self,
        name: str,
        description: FmuDescription,
        folder: Path,
        inputs: Sequence[FmuPort],
        outputs: Sequence[FmuPort],
        settings: Sequence[Setting] = (),
        inputs_at_start: Mapping[str, float | np.ndarray] | None = None,
        outputs_at_start: Mapping[str, float | np.ndarray] | None = None,
        setup: Setup = Setup(),  # noqa: B008, it is frozen
        solver: Solver = Solver(),  # noqa: B008, it is frozen
    ):
        self._solver = solver
        super().__init__(name, description, folder, inputs, outputs, settings, inputs_at_start, outputs_at_start, setup)

    @property
    def called(self) -> str:
        return "its equations of model exchange"

    def explain(self, status: int) -> str:
        told = self._integrator.explain(status) if self._integrator else ""
        return f"{told}{self._said}" if told else super().explain(status)

    def rewind(self) -> Rewind | None:
        of_fmu = super().rewind()
        if of_fmu is None or self._integrator is None:
            return None
        return joined_rewind(of_fmu, record_rewind(self._integrator.block))

    def close(self) -> None:
        if self._integrator is not None:
            self._integrator.close()
        super().close()

    def _stepping(self, inputs: Sequence[FmuPort], outputs: Sequence[FmuPort]) -> tuple[int, np.ndarray]:
        assert isinstance(self.instance, Model)
        width = sum(p.port.size for p in inputs)
        tables = [table for table, _ in self._groups]
        self._integrator = Integrator(self.instance, self._solver, tables, width)
        return self._integrator.address, self._integrator.memory
