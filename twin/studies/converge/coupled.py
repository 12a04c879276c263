"""Drives and plant as one differential equation, compiled."""

import numpy as np
from numpy.typing import ArrayLike, NDArray

from twin.compiled.native import entry
from twin.cosim.record import memory_of, record
from twin.plant.component import STILL, outputs_near
from twin.plant.dynamics import UNTOUCHED, derivative
from twin.plant.equations import MOTION
from twin.plant.friction import ANCHORS
from twin.plant.parameters import PARAMETERS, STATES, PlantParameters
from twin.plant.surface import apex_frame

_COUPLED = record(
    parameters=PARAMETERS, **dict.fromkeys(("T_m", "droop", "omega_ref", "theta_m", "omega_m"), "3f8"),
    **dict.fromkeys(("dtheta_m", "domega_m"), "3f8"), x=("f8", (STATES,)), dx=("f8", (STATES,)),
    anchors=("f8", (3, ANCHORS)), y=MOTION,
)  # fmt: skip
"""Constants, command, state, derivative; where dry friction holds, which is nowhere; outputs of the plant."""


@entry("nothing", _COUPLED)
def _derive(m):
    outputs_near(m.parameters, m.x, m.theta_m, STILL, STILL, apex_frame(m.parameters), m.anchors, m.y)
    for leg in range(3):
        target = m.omega_ref[leg] - m.droop[leg] * m.y.tau_load[leg]
        if m.T_m[leg] > 0.0:
            m.dtheta_m[leg] = m.omega_m[leg]
            m.domega_m[leg] = (target - m.omega_m[leg]) / m.T_m[leg]
        else:
            m.dtheta_m[leg], m.domega_m[leg] = target, 0.0
    derivative(m.parameters, m.x, m.theta_m, STILL, STILL, m.dx)


class Coupled:
    """dx/dt at x = (theta_m (3), omega_m (3), the plant's state (8)), SI; the surface stays at rest.

    Args:
        parameters: of the plant.
        T_m, droop: of each drive in s and rad/s per N m, (3,) each.
    """

    def __init__(self, parameters: PlantParameters, T_m: ArrayLike, droop: ArrayLike):
        self._memory = memory_of(_COUPLED, parameters=tuple(parameters), T_m=T_m, droop=droop)

    def derivative(self, omega_ref: ArrayLike, x: NDArray[np.float64]) -> NDArray[np.float64]:
        """dx/dt (14,) with the command `omega_ref` (3,) in rad/s."""
        m = self._memory
        m["omega_ref"], m["theta_m"], m["omega_m"], m["x"], m["anchors"] = omega_ref, x[:3], x[3:6], x[6:], UNTOUCHED
        _derive(m)
        return np.concatenate([m[name][0] for name in ("dtheta_m", "domega_m", "dx")])
