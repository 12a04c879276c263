"""A rotor of ours behind a drive whose FMU gives a torque and leaves the shaft to others."""

import math

import numpy as np

from twin.cosim.component import NativeComponent
from twin.cosim.native import step_function
from twin.cosim.record import memory_of, record
from twin.drive.contract import LOAD, OMEGA_M, TAU_MOTOR, THETA_M

INPUTS = (TAU_MOTOR.port, LOAD.port)
OUTPUTS = (THETA_M.port, OMEGA_M.port)
MEMORY = record(J="f8", b="f8", theta="f8", omega="f8")


@step_function(MEMORY, INPUTS, OUTPUTS)
def step(m, t, h, u, y):
    # J d omega/dt = tau_motor - tau_load - b omega, exactly, for torques held over the step
    alpha = (u.tau_motor - u.tau_load - m.b * m.omega) / m.J
    x = m.b * h / m.J
    # the first two phi functions of exponential integrators, at -x; (1 - phi_1)/x would cancel for small x
    phi_1 = -math.expm1(-x) / x if x > 0.0 else 1.0
    phi_2 = (1.0 - phi_1) / x if x > 1e-2 else 0.5 - x / 6.0 * (1.0 - x / 4.0 * (1.0 - x / 5.0 * (1.0 - x / 6.0)))
    m.theta += h * (m.omega + h * alpha * phi_2)
    m.omega += h * alpha * phi_1
    y.theta_m, y.omega_m = m.theta, m.omega
    return 0


class DriveRotor(NativeComponent):
    """Continuous component: torques in, angle and speed of the shaft out.

    Args:
        J: inertia at the motor shaft (kg m2).
        b: viscous friction (N m per rad/s).
        theta_m: angle at t = 0 (rad), where it is at rest.
    """

    def __init__(self, J: float, b: float, theta_m: float):
        memory = memory_of(MEMORY, J=J, b=b, theta=theta_m)
        super().__init__("rotor", INPUTS, OUTPUTS, False, step, memory, np.array([theta_m, 0.0]))
