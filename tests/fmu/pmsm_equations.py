"""The equations of fmus/pmsm_foc/README.md in Python: the controller as printed, the machine by scipy."""

from dataclasses import dataclass, field
from math import exp, floor, hypot, pi, sqrt

import numpy as np
from scipy.integrate import solve_ivp


@dataclass
class Pmsm:
    """Machine and controller with their default parameters; numbers in brackets: the README's equations."""

    p: float = 7.0
    psi: float = 0.01
    R: float = 0.5
    L: float = 0.5e-3
    J_m: float = 1e-4
    b_m: float = 5e-5
    tau_c: float = 0.002
    omega_c: float = 0.05
    V_bus: float = 24.0
    i_max: float = 5.7
    counts: float = 2.0**20
    T_c: float = 50e-6
    omega_i: float = 2 * pi * 1000
    omega_v: float = 2 * pi * 40
    omega_o: float = 2 * pi * 300

    x: np.ndarray = field(init=False, default_factory=lambda: np.zeros(4))  # i_d, i_q, omega_m, theta_m
    v_d: float = field(init=False, default=0.0)
    v_q: float = field(init=False, default=0.0)
    i_q_ref: float = field(init=False, default=0.0)
    theta_obs: float = field(init=False, default=0.0)
    omega_obs: float = field(init=False, default=0.0)
    x_v: float = field(init=False, default=0.0)
    x_d: float = field(init=False, default=0.0)
    x_q: float = field(init=False, default=0.0)

    @property
    def k_t(self) -> float:
        """Torque per current in (4)."""
        return 1.5 * self.p * self.psi

    def tick(self, omega_ref: float) -> None:
        """One tick of the controller."""
        i_d, i_q, _, theta_m = self.x

        step = 2 * pi / self.counts  # (6)
        theta = step * floor(theta_m / step + 0.5)

        z = exp(-self.omega_o * self.T_c)  # (7)
        predicted = self.theta_obs + self.T_c * self.omega_obs
        self.theta_obs = predicted + (1 - z**2) * (theta - predicted)
        self.omega_obs += (1 - z) ** 2 / self.T_c * (theta - predicted)

        kp = self.J_m * self.omega_v / self.k_t  # (8)
        ki = kp * self.omega_v / 4
        error = omega_ref - self.omega_obs
        wanted = kp * error + self.x_v
        self.i_q_ref = float(np.clip(wanted, -self.i_max, self.i_max))  # (9)
        self.x_v += ki * self.T_c * (error + (self.i_q_ref - wanted) / kp)

        r = 1 - exp(-self.R / self.L * self.T_c)  # (10)
        kp = self.R * (1 - exp(-self.omega_i * self.T_c)) / r
        omega_e = self.p * self.omega_obs
        u_d = kp * (0 - i_d) + self.x_d - omega_e * self.L * i_q  # (11)
        u_q = kp * (self.i_q_ref - i_q) + self.x_q + omega_e * (self.L * i_d + self.psi)
        scale = min(1.0, self.V_bus / sqrt(3) / max(hypot(u_d, u_q), 1e-300))  # (12)
        self.v_d, self.v_q = scale * u_d, scale * u_q
        self.x_d += r * (kp * (0 - i_d) + self.v_d - u_d)  # (13)
        self.x_q += r * (kp * (self.i_q_ref - i_q) + self.v_q - u_q)

    def rates(self, t: float, x: np.ndarray, tau_load: float) -> list[float]:
        """(1) to (5)"""
        i_d, i_q, omega_m, _ = x
        omega_e = self.p * omega_m
        friction = self.b_m * omega_m + self.tau_c * omega_m / hypot(omega_m, self.omega_c)
        return [
            (self.v_d - self.R * i_d + omega_e * self.L * i_q) / self.L,
            (self.v_q - self.R * i_q - omega_e * (self.L * i_d + self.psi)) / self.L,
            (self.k_t * i_q - tau_load - friction) / self.J_m,
            omega_m,
        ]

    def run(self, omega_ref: float, tau_load: float, ticks: int) -> None:
        """Controller and machine in turn, the machine to a relative tolerance of 1e-11."""
        for _ in range(ticks):
            self.tick(omega_ref)
            span = (0.0, self.T_c)
            run = solve_ivp(self.rates, span, self.x, "DOP853", args=(tau_load,), rtol=1e-11, atol=1e-14)
            self.x = run.y[:, -1]
