"""A drive written in Python instead of compiled C: the same ports, the same place, slower.

Run `python examples/python_component.py` from the repository's folder.
"""

import math

import numpy as np

from twin.kernel.cosim.port import Port
from twin.kernel.cosim.python_class import PythonComponent
from twin.kernel.cosim.simulation import Simulation
from twin.kernel.cosim.system import System

THETA_M = Port("theta_m", 1, "rad", "motor angle")
OMEGA_REF = Port("omega_ref", 1, "rad/s", "commanded motor speed")


class LaggingDrive:
    """d omega_m/dt = (omega_ref - omega_m) / T_m, d theta_m/dt = omega_m, solved exactly with omega_ref held."""

    inputs = (OMEGA_REF,)
    outputs = (THETA_M,)
    sampled = False

    def __init__(self, T_m: float):
        self.T_m = T_m
        self.theta_m = self.omega_m = 0.0

    def step(self, t: float, h: float, u: np.ndarray, y: np.ndarray) -> None:
        error = u[0] - self.omega_m
        decay = -math.expm1(-h / self.T_m)
        self.theta_m += u[0] * h - error * self.T_m * decay
        self.omega_m += error * decay
        y[0] = self.theta_m


class PositionController:
    """omega_ref = kp (theta_ref - theta_m), once per period."""

    inputs = (THETA_M,)
    outputs = (OMEGA_REF,)
    sampled = True

    def __init__(self, kp: float, theta_ref: float):
        self.kp = kp
        self.theta_ref = theta_ref

    def step(self, t: float, h: float, u: np.ndarray, y: np.ndarray) -> None:
        y[0] = self.kp * (self.theta_ref - u[0])


def step_response(seconds: float = 1.0, tick: float = 1e-3) -> tuple[np.ndarray, np.ndarray]:
    """Times (s) and motor angles (rad), one of each per tick: a position loop around a lagging drive."""
    system = System(
        [
            PythonComponent("controller", PositionController(kp=10.0, theta_ref=0.5), period=2),
            PythonComponent("drive", LaggingDrive(T_m=0.02)),
        ],
        [("drive.theta_m", "controller.theta_m"), ("controller.omega_ref", "drive.omega_ref")],
        tick,
    )
    last_tick = round(seconds / tick)
    rows = Simulation(system, last_tick).run()
    return tick * np.arange(last_tick + 1), rows[:, system.columns("drive.theta_m")].ravel()


if __name__ == "__main__":
    t, theta_m = step_response()
    for k in range(0, len(t), 100):
        print(f"t = {t[k]:.1f} s   theta_m = {theta_m[k]:.4f} rad")
