"""A model-exchange FMU as a component: its equations, a solver of ours, and a step like any other's."""

from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

import numpy as np

from twin.drive.component import FmuComponent
from twin.drive.description import FmuDescription
from twin.drive.exchange.integrator import Integrator
from twin.drive.exchange.model import Model
from twin.drive.exchange.solver import Solver
from twin.drive.ports import FmuPort, placed
from twin.drive.setting import Setting
from twin.drive.setup import Setup
from twin.drive.shorter import SHORTER
from twin.drive.stepping import Stepping


class ExchangeStepping(Stepping):
    """How a model-exchange FMU is stepped.

    Args:
        instance: in continuous-time mode.
        solver: of its equations.
        inputs, outputs, shift: as those of `Stepping`.

    Attributes:
        integrator: what the step works on.

    Raises:
        InputRefused: there is no CVODE for this platform.
    """

    def __init__(
        self,
        instance: Model,
        solver: Solver,
        inputs: Sequence[FmuPort],
        outputs: Sequence[FmuPort],
        shift: np.ndarray,
    ):
        self.instance, self.inputs = instance, list(inputs)
        self._keep: list[Any] = []
        self._moving: list[np.ndarray] = []
        self._shorter = np.zeros(1, dtype=SHORTER)
        tables = self._grouped(placed(inputs), "Set"), self._grouped(placed(outputs, shift), "Get")
        self.integrator = Integrator(instance, solver, tables, sum(p.port.size for p in inputs))
        self._moving.append(self.integrator.block)
        self.address, self.memory = self.integrator.address, self.integrator.memory

    def explain(self, status: int) -> str:
        told = self.integrator.explain(status)
        said = f" ('{self.instance.messages[-1]}')" if self.instance.messages else ""
        return f"{told}{said}" if told else super().explain(status)


class ExchangeComponent(FmuComponent):
    """One model-exchange FMU and its solver as a continuous component.

    Args:
        solver: which; all others are those of `FmuComponent`.

    Raises:
        InputRefused: as `FmuComponent`, or there is no CVODE for this platform.
    """

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

    def close(self) -> None:
        if isinstance(self._stepping, ExchangeStepping):
            self._stepping.integrator.close()
        super().close()

    def _stepped(self, inputs: Sequence[FmuPort], outputs: Sequence[FmuPort], shift: np.ndarray) -> Stepping:
        assert isinstance(self.instance, Model)
        return ExchangeStepping(self.instance, self._solver, inputs, outputs, shift)
