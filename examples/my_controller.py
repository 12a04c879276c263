"""A controller in Python instead of twin's own: it follows the pre-defined way and gives way to what it feels.

twin component check controller examples/my_controller.py:Controller
twin run fig4_force_position --set controller.python=examples/my_controller.py:Controller
"""

from collections.abc import Mapping
from typing import Any

import numpy as np


class Controller:
    """omega_ref = N J (kp (p_ref - p) + g F_low): a position loop that gives way, admittance for short.

    Args:
        kp: platform speed per position error (1/s).
        give: platform speed per force felt (m/s per N).
        N: belt ratio.
    """

    inputs = ("p_B", "J", "F_ee_B", "p_ref_B")
    outputs = ("omega_ref", "p_ref_B", "F_z")

    def __init__(self, kp: float = 1.5, give: float = 0.0, N: float = 2.0):
        self.kp, self.give, self.N = kp, give, N
        self.force = np.zeros(3)

    def step(self, t: float, inputs: Mapping[str, Any]) -> dict[str, Any]:
        """Called at t_k (s) with what the robot believes then, SI; what it returns holds from t_k on."""
        self.force += 0.1 * (inputs["F_ee_B"] - self.force)
        v = self.kp * (inputs["p_ref_B"] - inputs["p_B"]) - self.give * self.force
        omega_ref = self.N * inputs["J"].reshape(3, 3) @ v
        return {"omega_ref": np.clip(omega_ref, -8.0, 8.0), "p_ref_B": inputs["p_ref_B"], "F_z": -self.force[2]}
