"""A sampled component evaluated outside any system."""

import ctypes
from collections.abc import Mapping

import numpy as np
from numpy.typing import NDArray

from twin.cosim.component import Component
from twin.cosim.port import places, width
from twin.errors import ComponentFailed

_STEP = ctypes.CFUNCTYPE(
    ctypes.c_int32, ctypes.c_void_p, ctypes.c_double, ctypes.c_double, ctypes.c_void_p, ctypes.c_void_p
)


class Sampled:
    """A component stepped by hand: all its input values in, all its output values out.

    Calling it raises `ValueError` for another number of inputs, `ComponentFailed` for a bad status.
    """

    def __init__(self, component: Component):
        self.component = component
        self._step = _STEP(component.step_address)
        self._y = component.initial_outputs.copy()
        self._places = places(component.outputs)

    def __call__(self, u: NDArray[np.float64], t: float = 0.0, h: float = 2e-3) -> NDArray[np.float64]:
        u = np.ascontiguousarray(u, dtype=float)
        if len(u) != width(self.component.inputs):
            raise ValueError(f"{self.component.name}: {len(u)} inputs; expected {width(self.component.inputs)}")
        status = self._step(self.component.self_address, t, h, u.ctypes.data, self._y.ctypes.data)
        # 1 is a warning
        if status not in (0, 1):
            raise ComponentFailed(f"{self.component.name} {self.component.explain(status)}")
        return self._y.copy()

    def named(
        self, u: NDArray[np.float64] | Mapping[str, NDArray[np.float64]], t: float = 0.0, h: float = 2e-3
    ) -> dict[str, NDArray[np.float64]]:
        """The outputs by port; `u` may hold the inputs by port likewise, among others."""
        if isinstance(u, Mapping):
            u = np.concatenate([np.atleast_1d(u[port.name]) for port in self.component.inputs])
        y = self(u, t, h)
        return {name: y[place] for name, place in self._places.items()}
