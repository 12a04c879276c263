"""The equations of the README of brushed_dc, as they stand there."""

from dataclasses import dataclass
from math import hypot

import numpy as np


def soft_sign(x: float, width: float) -> float:
    return x / hypot(x, width)


@dataclass(frozen=True)
class Motor:
    """Equations (1) to (9) with the default parameters, without the current limit (4)."""

    R: float = 4.0
    L: float = 3e-3
    k_t: float = 0.0373
    J_m: float = 3.5e-6
    b_m: float = 2.3e-6
    tau_c: float = 4.2e-3
    omega_c: float = 0.3
    G: float = 19.7
    eta: float = 0.8
    u_brush: float = 0.3
    i_c: float = 0.05
    alpha: float = 3.93e-3
    R_th: float = 19.1
    C_th: float = 30.0
    i_max: float = 3.0
    dead: float = 0.5e-6 * 20e3
    levels: float = 1024.0

    def resistance(self, T_w: float) -> float:
        """(6)"""
        return self.R * (1 + self.alpha * (T_w - 25.0))

    def bridge(self, u_cmd: float, i: float, v_bus: float = 24.0) -> float:
        """(1), (2)"""
        d = np.floor(np.clip(u_cmd / v_bus, -1.0, 1.0) * self.levels + 0.5) / self.levels
        return float(d) * v_bus - self.dead * v_bus * soft_sign(i, self.i_c)

    def holding(self, i: float, omega: float, T_w: float) -> float:
        """(3)"""
        return self.resistance(T_w) * i + self.u_brush * soft_sign(i, self.i_c) + self.k_t * omega

    def friction(self, omega: float, M_load: float) -> float:
        """(7) and the viscous part of (8); M_load in N m after the gearbox."""
        coulomb = self.tau_c + (1 / self.eta - 1) * abs(M_load) / self.G
        return self.b_m * omega + coulomb * soft_sign(omega, self.omega_c)

    def rates(self, t: float, x: np.ndarray, u_cmd: float, M_load: float) -> list[float]:
        """(5), (8), (9) of i_a, omega, phi, T_w."""
        i, omega, _, T_w = x
        return [
            (self.bridge(u_cmd, i) - self.holding(i, omega, T_w)) / self.L,
            (self.k_t * i - M_load / self.G - self.friction(omega, M_load)) / self.J_m,
            omega / self.G,
            ((self.resistance(T_w) * i + self.u_brush * soft_sign(i, self.i_c)) * i - (T_w - 25.0) / self.R_th)
            / self.C_th,
        ]
