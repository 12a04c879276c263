"""The job of a drive in the robot, alone on a bench: a spring to wind slowly, under a position loop.

The spring's far end is held: tau_load = k_s theta_m with k_s = 1 N m/rad. The position loop commands
omega_ref = 1.5 1/s (theta_ref - theta_m) every 2 ms; theta_ref rises to 0.1 rad (0.1 N m) in 2 s, then swings by
0.05 rad at 0.25 Hz. A drive that takes no speed gets the discrete PI of its mapping.toml in front of it.
"""

import tomllib
from collections.abc import Mapping
from dataclasses import dataclass
from math import pi, sin
from typing import Any, Protocol

import numpy as np

from .rig import FMUS

K_S = 1.0
KP = 1.5
TICK = 2e-3


class Bench(Protocol):
    """What the sweep needs of a rig."""

    def __getitem__(self, name: str) -> Any: ...
    def __setitem__(self, name: str, value: float) -> None: ...
    def step(self, h: float) -> None: ...


@dataclass
class VelocityLoop:
    """u = clamp(kp e + x), e = omega_ref - omega_m; what the clamp cuts off is taken back from the integral x."""

    kp: float
    ki: float
    limit: float
    period: float
    x: float = 0.0

    def command(self, omega_ref: float, omega_m: float) -> float:
        """The command for the next period."""
        error = omega_ref - omega_m
        wanted = self.kp * error + self.x
        u = min(max(wanted, -self.limit), self.limit)
        self.x += self.ki * self.period * (error + (u - wanted) / self.kp)
        return u


def mapping(drive: str) -> dict[str, Any]:
    """The drive's mapping.toml, as written."""
    return tomllib.loads((FMUS / drive / "mapping.toml").read_text(encoding="utf-8"))


def mapped_loop(drive: str) -> VelocityLoop:
    """The velocity loop of the drive's mapping.toml."""
    settings = mapping(drive)["velocity_loop"]
    return VelocityLoop(settings["kp"], settings["ki"], settings["limit"], settings["period_ms"] * 1e-3)


def reference(t: float) -> float:
    """theta_ref (rad) at time t (s)."""
    return 0.1 * min(max(t - 0.5, 0.0) / 2.0, 1.0) + 0.05 * sin(2 * pi * 0.25 * max(0.0, t - 3.0))


def swept(bench: Bench, names: Mapping[str, str], loop: VelocityLoop | None, duration: float) -> np.ndarray:
    """Wind the spring; rows of omega_ref, omega_m at the end of every tick, shape (ticks, 2), rad/s.

    Args:
        bench: the drive, initialised and at rest. names: its own names for `command`, `tau_load`, `theta_m`,
            `omega_m`. loop: in front of it, None for a drive that takes a speed. duration: in s.
    """
    rows = []
    for k in range(round(duration / TICK)):
        omega_ref = KP * (reference(k * TICK) - bench[names["theta_m"]])
        parts = round(TICK / loop.period) if loop else 2
        for _ in range(parts):
            bench[names["tau_load"]] = K_S * bench[names["theta_m"]]
            bench[names["command"]] = loop.command(omega_ref, bench[names["omega_m"]]) if loop else omega_ref
            bench.step(TICK / parts)
        rows.append((omega_ref, bench[names["omega_m"]]))
    return np.array(rows)
