"""A component written as a plain Python class: the same interface, slower (a callback per step)."""

import ctypes
from collections.abc import Sequence
from typing import Protocol

import numpy as np

from twin.cosim.component import Component
from twin.cosim.port import Port, width

FAILED = 2
STEP = ctypes.CFUNCTYPE(
    ctypes.c_int32, ctypes.c_void_p, ctypes.c_double, ctypes.c_double, ctypes.c_void_p, ctypes.c_void_p
)


class PythonModel(Protocol):
    """What a plain class needs to take part.

    Plain class attributes serve as the three properties.
    """

    @property
    def inputs(self) -> Sequence[Port]:
        """Its input ports."""

    @property
    def outputs(self) -> Sequence[Port]:
        """Its output ports."""

    @property
    def sampled(self) -> bool:
        """See `Component`."""

    def step(self, t: float, h: float, u: np.ndarray, y: np.ndarray) -> None:
        """Read inputs `u`, write outputs `y` in place; raise to stop the run."""


class PythonComponent(Component):
    """Wraps a `PythonModel`; `initial_outputs` defaults to zeros."""

    def __init__(self, name: str, model: PythonModel, period: int = 1, initial_outputs: Sequence[float] | None = None):
        inputs, outputs = tuple(model.inputs), tuple(model.outputs)
        views: dict[tuple[int, int], tuple[np.ndarray, np.ndarray]] = {}
        self.exception: BaseException | None = None

        def callback(_self: int, t: float, h: float, u: int, y: int) -> int:
            if (u, y) not in views:
                views[u, y] = (doubles(u, width(inputs)), doubles(y, width(outputs)))
            try:
                model.step(t, h, *views[u, y])
            # Anything that leaves a callback would be printed and lost; it is kept for `explain`.
            except BaseException as exception:
                self.exception = exception
                return FAILED
            return 0

        function = STEP(callback)
        super().__init__(
            name=name,
            inputs=inputs,
            outputs=outputs,
            sampled=model.sampled,
            step_address=ctypes.cast(function, ctypes.c_void_p).value or 0,
            self_address=0,
            initial_outputs=np.zeros(width(outputs))
            if initial_outputs is None
            else np.asarray(initial_outputs, dtype=float),
            period=period,
            label=type(model).__name__,
            keep=function,
        )

    def explain(self, status: int) -> str:
        if isinstance(self.exception, KeyboardInterrupt):
            raise self.exception
        return f"raised {type(self.exception).__name__}: {self.exception}"


def doubles(address: int, count: int) -> np.ndarray:
    if count == 0:
        return np.empty(0)
    return np.ctypeslib.as_array((ctypes.c_double * count).from_address(address))
