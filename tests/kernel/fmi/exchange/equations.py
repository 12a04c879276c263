"""The equations of motor.c in Python, solved by scipy with its events: what the FMU is held to."""

from collections.abc import Callable

import numpy as np
from scipy.integrate import solve_ivp

PARAMETERS = {
    "R": 2.0,
    "L": 0.004,
    "k": 0.1,
    "J": 1e-4,
    "b": 1e-3,
    "kp": 2.0,
    "i_max": 100.0,
    "stop": 1e6,
    "bounce": 0.5,
}
"""Of motor.c, where nothing else is set."""
EXACT = {"rtol": 1e-12, "atol": 1e-14, "method": "DOP853"}


def exact_motor(omega_ref: np.ndarray, tau_load: np.ndarray, tick: float, **changed: float) -> np.ndarray:
    """Angle, speed and current at the start of each tick, (ticks, 3); the inputs (ticks,) are held from tick to tick.

    Args:
        changed: parameters that are other than `PARAMETERS`; `switch_every` halves and restores the supply (s).
    """
    p = PARAMETERS | changed
    every = changed.get("switch_every", np.inf)
    x, limited, rows = np.zeros(3), False, []
    for n in range(len(omega_ref)):
        rows.append(x.copy())
        t, end, jumped = n * tick, (n + 1) * tick, True
        for _ in range(1000):
            if t >= end - 1e-12:
                break
            switched = int(np.floor(t / every + 1e-9)) if np.isfinite(every) else 0
            stop = min(end, (switched + 1) * every)
            supply = 0.5 if switched % 2 else 1.0
            if jumped:
                limited = _relation(p, supply, omega_ref[n], x, limited)
            rate = _rates(p, supply, omega_ref[n], tau_load[n], limited)
            events = _events(p, supply, omega_ref[n], limited)
            done = solve_ivp(rate, (t, stop), x, events=events, **EXACT)
            t, x, jumped = float(done.t[-1]), done.y[:, -1].copy(), done.status == 0
            if done.status == 1 and len(done.t_events[1]):
                x[1] *= -p["bounce"] if x[1] > 0.0 else 1.0
            elif done.status == 1:
                limited = not limited
                if limited:
                    x[2] = np.copysign(p["i_max"], x[2])
        else:
            raise AssertionError("the events of one tick come to no end")
    return np.array(rows)


def _free_rate(p: dict[str, float], supply: float, omega_ref: float, x: np.ndarray) -> float:
    return float((supply * p["kp"] * (omega_ref - x[1]) - p["R"] * x[2] - p["k"] * x[1]) / p["L"])


def _relation(p: dict[str, float], supply: float, omega_ref: float, x: np.ndarray, limited: bool) -> bool:
    """Whether the limiter is active when an input or the supply has just jumped."""
    pushed = x[2] * _free_rate(p, supply, omega_ref, x) > 0.0
    return pushed if limited else pushed and abs(x[2]) >= p["i_max"]


def _rates(
    p: dict[str, float], supply: float, omega_ref: float, tau_load: float, limited: bool
) -> Callable[[float, np.ndarray], list[float]]:
    def rates(t: float, x: np.ndarray) -> list[float]:
        rising = 0.0 if limited else _free_rate(p, supply, omega_ref, x)
        return [x[1], (p["k"] * x[2] - p["b"] * x[1] - tau_load) / p["J"], rising]

    return rates


def _events(p: dict[str, float], supply: float, omega_ref: float, limited: bool) -> list[Callable]:
    def limiter(t: float, x: np.ndarray) -> float:
        if limited:
            return float(np.sign(x[2])) * _free_rate(p, supply, omega_ref, x)
        return p["i_max"] - abs(float(x[2]))

    def end_stop(t: float, x: np.ndarray) -> float:
        return p["stop"] - float(x[0])

    for event in (limiter, end_stop):
        event.terminal, event.direction = True, -1.0  # type: ignore[attr-defined]
    return [limiter, end_stop]
