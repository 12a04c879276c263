"""Drives and plant as one differential equation, compiled."""

import numpy as np

from twin.compiled.function import njit
from twin.cosim.port import port_record
from twin.plant.component import OUTPUTS, STILL, outputs
from twin.plant.dynamics import derivative

MOTION = port_record(OUTPUTS)


@njit(cache=True)
def coupled_derivative(parameters, T_m, droop, omega_ref, x):
    """dx/dt (14,) at x = (theta_m (3), omega_m (3), the plant's state (8)), SI.

    Args:
        parameters: `PlantParameters`; the surface stays at rest.
        T_m, droop: of each drive in s and rad/s per N m, (3,) each.
        omega_ref: command in rad/s, (3,).
    """
    dx = np.zeros_like(x)
    y = np.empty(1, dtype=MOTION)[0]
    outputs(parameters, x[6:], x[:3], STILL, STILL, y)
    for leg in range(3):
        target = omega_ref[leg] - droop[leg] * y.tau_load[leg]
        if T_m[leg] > 0.0:
            dx[leg] = x[3 + leg]
            dx[3 + leg] = (target - x[3 + leg]) / T_m[leg]
        else:
            dx[leg] = target
    derivative(parameters, x[6:], x[:3], STILL, STILL, dx[6:])
    return dx
