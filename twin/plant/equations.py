"""The plant's equations for Python, where they are analysed rather than stepped; the surface stays at rest.

The right-hand side and the outputs are those that the component steps: nothing of the physics is written here.
"""

import numpy as np
from numpy.typing import ArrayLike, NDArray

from twin.compiled.native import entry
from twin.cosim.port import memory_of, port_record, record
from twin.plant.component import OUTPUTS, STILL, outputs_near, settle
from twin.plant.contact import ANCHORS
from twin.plant.dynamics import UNTOUCHED, derivative_near, settle_friction
from twin.plant.parameters import PARAMETERS, STATES, PlantParameters
from twin.plant.surface import apex_frame

MOTION = port_record(OUTPUTS)
_AT = record(
    parameters=PARAMETERS, x=("f8", (STATES,)), theta_m="3f8", anchors=("f8", (3, ANCHORS)), dx=("f8", (STATES,))
)
"""State, motor angles (rad), where dry friction holds, derivative."""


@entry("nothing", _AT)
def _derive(m):
    derivative_near(m.parameters, m.x, m.theta_m, STILL, STILL, m.anchors, m.dx)


@entry("nothing", _AT, MOTION)
def _read(m, y):
    outputs_near(m.parameters, m.x, m.theta_m, STILL, STILL, apex_frame(m.parameters), m.anchors, y)


@entry("nothing", _AT)
def _hold(m):
    settle_friction(m.parameters, m.x, m.theta_m, m.anchors)


@entry("nothing", _AT)
def _settle(m):
    settle(m.parameters, apex_frame(m.parameters), m.x, STILL, STILL)


class Equations:
    """The plant's equations with given constants.

    Args:
        parameters: what is true.
    """

    def __init__(self, parameters: PlantParameters):
        self._at = memory_of(_AT, parameters=tuple(parameters), anchors=UNTOUCHED)

    def hold(self, x: ArrayLike, theta_m: ArrayLike) -> None:
        """From now on dry friction holds at the state `x` (8,), at motor angles `theta_m` (3,) in rad."""
        self._put(x, theta_m)
        self._at["anchors"] = UNTOUCHED
        _hold(self._at)

    def derivative(self, x: ArrayLike, theta_m: ArrayLike) -> NDArray[np.float64]:
        """dx/dt (8,); outside the workspace NaN."""
        self._put(x, theta_m)
        _derive(self._at)
        dx: NDArray[np.float64] = self._at["dx"][0].copy()
        return dx

    def outputs(self, x: ArrayLike, theta_m: ArrayLike) -> np.ndarray:
        """The component's outputs (1,), a record of `MOTION`, with no dry friction that remembers where it was."""
        self._put(x, theta_m)
        self._at["anchors"] = UNTOUCHED
        y = np.empty(1, dtype=MOTION)
        _read(self._at, y)
        return y

    def settled(self, x: ArrayLike) -> NDArray[np.float64]:
        """`x` with its bristle scaled back onto the friction cone, as at the end of every integration step."""
        self._at["x"] = x
        _settle(self._at)
        settled: NDArray[np.float64] = self._at["x"][0].copy()
        return settled

    def _put(self, x: ArrayLike, theta_m: ArrayLike) -> None:
        self._at["x"], self._at["theta_m"] = x, theta_m
