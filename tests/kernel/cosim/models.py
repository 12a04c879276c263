"""Plain Python models that the tests of the master are built from."""

from collections.abc import Callable, Sequence
from typing import Any

import numpy as np

from twin.kernel.cosim.port import Port
from twin.kernel.cosim.python_class import PythonComponent

Law = Callable[[float, float, np.ndarray], Any]


class Model:
    """Outputs are whatever `law(t, h, u)` returns.

    Attributes:
        calls: (t, h, inputs) of every step.
    """

    def __init__(self, law: Law, sampled: bool, inputs: Sequence[Port], outputs: Sequence[Port]):
        self.inputs, self.outputs, self.sampled = inputs, outputs, sampled
        self.calls: list[tuple[float, float, list[float]]] = []
        self._law = law

    def step(self, t: float, h: float, u: np.ndarray, y: np.ndarray) -> None:
        self.calls.append((t, h, u.tolist()))
        y[:] = self._law(t, h, u)


class Part(PythonComponent):
    """A component of a `Model` with, unless told otherwise, no inputs and one output `y`."""

    def __init__(
        self,
        name: str,
        law: Law,
        sampled: bool,
        inputs: Sequence[Port] = (),
        outputs: Sequence[Port] = (Port("y"),),
        period: int = 1,
        initial_outputs: Sequence[float] | None = None,
    ):
        self.model = Model(law, sampled, inputs, outputs)
        super().__init__(name, self.model, period, initial_outputs)


def sampled(name: str, law: Law, inputs: Sequence[Port] = (), **options: Any) -> Part:
    return Part(name, law, True, inputs, **options)


def continuous(name: str, law: Law, inputs: Sequence[Port] = (), **options: Any) -> Part:
    return Part(name, law, False, inputs, **options)


def clock(t: float, h: float, u: np.ndarray) -> float:
    """The time at which the outputs of this step are valid, of a continuous component."""
    return t + h


def echo(t: float, h: float, u: np.ndarray) -> np.ndarray:
    return u


U = (Port("u"),)
