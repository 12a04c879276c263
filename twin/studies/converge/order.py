"""How fast an error falls with the tick.

What is compared: the signals on either side of the coupling and the force that the twin is for.
"""

from dataclasses import dataclass
from enum import StrEnum

import numpy as np
from numpy.typing import ArrayLike, NDArray

from twin.kernel.cosim.observers import simulate
from twin.robot.assembly.assemble import assemble
from twin.robot.experiment.experiment import Experiment
from twin.robot.run.trace import Trace


@dataclass(frozen=True)
class Signal:
    """name: as in recordings. unit, scale: for people, and how many of these are one SI unit."""

    name: str
    unit: str
    scale: float = 1.0


SIGNALS = (
    Signal("F_z", "mN", 1e3),
    Signal("p_B", "um", 1e6),
    Signal("theta_m", "urad", 1e6),
    Signal("tau_load", "uN m", 1e6),
)
FORCE, POSITION = SIGNALS[:2]

Samples = dict[str, NDArray[np.float64]]
"""By name of the signal, (n, values): one row per tick of the controller."""


def chosen(plant: Samples, theta_m: NDArray[np.float64]) -> Samples:
    """The signals out of the plant's outputs, by "plant.port", and the motor angles (n, 3)."""
    return {
        "F_z": -plant["plant.F_ee_B"][:, 2:],
        "p_B": plant["plant.p_B"],
        "theta_m": theta_m,
        "tau_load": plant["plant.tau_load"],
    }


def sampled_run(experiment: Experiment) -> tuple[Samples, float]:
    """The signals of `experiment` run in this process, and wall time per simulated time of the master (1).

    Raises:
        InputRefused: a drive does not fit. ComponentFailed: a component failed.
    """
    run = Trace(experiment.controller_ticks)
    with assemble(experiment) as assembly:
        done = simulate(assembly, experiment.duration_ticks, [run]).completed()
    plant = {key: run[key] for key in ("plant.F_ee_B", "plant.p_B", "plant.tau_load")}
    simulated = experiment.duration_ticks * experiment.cosim.tick
    return chosen(plant, run.of_drives("theta_m")), done.stepping / simulated


def largest_errors(samples: Samples, reference: Samples) -> dict[str, float]:
    """The largest |difference| of any value at any time: nothing can cancel."""
    return {name: float(np.abs(values - reference[name]).max()) for name, values in samples.items()}


UNEVEN = 0.3
"""Slopes of neighbouring pairs that differ by more belong to no power of the tick."""
FEWEST = 3
"""So many errors above the floor make a slope that can contradict itself."""
LEAST = 0.5
"""A smaller slope is no order: what is left is not the coupling's error."""


class OrderFinding(StrEnum):
    """What can be said of an order."""

    SMOOTH = "smooth"
    NOT_SMOOTH = "not smooth"
    NOT_FALLING = "does not fall with the tick"
    AT_FLOOR = "at the reference's own accuracy"
    UNSTABLE = "not stable at every tick"


@dataclass(frozen=True)
class Order:
    """p in error = C tick^p; `slope` is None where it would mean nothing, and `finding` says why."""

    slope: float | None
    finding: OrderFinding


def observed_order(ticks: ArrayLike, errors: ArrayLike, floor: float) -> Order:
    """Least squares in log-log over the errors that say something of the coupling.

    Args:
        ticks: s, (n,).
        errors: >= 0, infinite where the run failed, (n,).
        floor: errors up to ten times this are left out: there the reference's own error is more than a tenth.
    """
    h, e = np.asarray(ticks, dtype=float), np.asarray(errors, dtype=float)
    if not np.all(np.isfinite(e)):
        return Order(None, OrderFinding.UNSTABLE)
    clear = e > 10.0 * floor
    if np.count_nonzero(clear) < FEWEST:
        return Order(None, OrderFinding.AT_FLOOR)
    by_tick = np.argsort(h[clear])
    log_h, log_e = np.log(h[clear][by_tick]), np.log(e[clear][by_tick])
    pairs = np.diff(log_e) / np.diff(log_h)
    slope = float(np.polyfit(log_h, log_e, 1)[0])
    if slope < LEAST:
        return Order(None, OrderFinding.NOT_FALLING)
    return Order(slope, OrderFinding.NOT_SMOOTH if np.ptp(pairs) > UNEVEN else OrderFinding.SMOOTH)
