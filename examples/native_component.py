"""The drive of python_component.py as compiled code: a memory layout, a step, and a component that joins them."""

import math

import numpy as np

from twin.kernel.cosim.component import Component, NativeComponent, step_function
from twin.kernel.cosim.port import Port

INPUTS = (Port("omega_ref", 1, "rad/s", "commanded motor speed"),)
OUTPUTS = (Port("theta_m", 1, "rad", "motor angle"),)
MEMORY = np.dtype([("T_m", "f8"), ("theta_m", "f8"), ("omega_m", "f8")], align=True)


@step_function(MEMORY, INPUTS, OUTPUTS)
def step(m, t, h, u, y):
    error = u.omega_ref - m.omega_m
    decay = -math.expm1(-h / m.T_m)
    m.theta_m += u.omega_ref * h - error * m.T_m * decay
    m.omega_m += error * decay
    y.theta_m = m.theta_m
    return 0


def lagging_drive(name: str, T_m: float) -> Component:
    """Continuous component: d omega_m/dt = (omega_ref - omega_m) / T_m, d theta_m/dt = omega_m, from rest."""
    memory = np.array([(T_m, 0.0, 0.0)], dtype=MEMORY)
    return NativeComponent(name, INPUTS, OUTPUTS, False, step, memory)
