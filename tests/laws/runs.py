"""Experiments of experiments/, co-simulated without recording, and sampled components evaluated by hand."""

import ctypes
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from twin.assembly import assemble
from twin.cosim.component import Component, width
from twin.cosim.simulation import Simulation
from twin.cosim.system import System
from twin.experiment.experiment import Experiment, load_experiment
from twin.experiment.true_parameters import plant_parameters

EXPERIMENTS = Path(__file__).resolve().parents[2] / "experiments"
FORCE, POSITION = "fig4_force_position", "fig4_position"
EVERY_EXPERIMENT = sorted(path.stem for path in EXPERIMENTS.glob("fig4_*.toml"))

EXACT_ENCODERS = tuple(
    f"{owner}.{encoder}_counts_per_turn={2**40}"
    for owner in ("plant", "controller.model")
    for encoder in ("motor", "joint")
)
"""Overrides that make a count 6e-12 rad."""

_STEP = ctypes.CFUNCTYPE(
    ctypes.c_int32, ctypes.c_void_p, ctypes.c_double, ctypes.c_double, ctypes.c_void_p, ctypes.c_void_p
)


def shipped(name: str = FORCE, *overrides: str) -> Experiment:
    """An experiment of experiments/ with `overrides` as in `twin run --set`."""
    return load_experiment(EXPERIMENTS / f"{name}.toml", overrides)


PARAMETERS = plant_parameters(shipped().plant, shipped().contact)
"""The plant of the shipped experiment."""


@dataclass(frozen=True)
class Rows:
    """A finished run: `rows["plant.F_ee_B"]` is (ticks, 3), a port of size 1 (ticks,)."""

    system: System
    values: NDArray[np.float64]

    def __getitem__(self, end: str) -> NDArray[np.float64]:
        columns = self.values[:, self.system.columns(end)]
        return columns.squeeze(axis=1) if columns.shape[1] == 1 else columns

    @property
    def t(self) -> NDArray[np.float64]:
        return np.arange(len(self.values), dtype=float) * self.system.tick


def co_simulated(experiment: Experiment, duration: float = 20.0) -> Rows:
    """`experiment` with its real drive FMUs, from 0 to `duration` (s)."""
    with assemble(experiment) as assembly:
        ticks = round(duration / experiment.cosim.tick)
        return Rows(assembly.system, Simulation(assembly.system, ticks).run())


class Sampled:
    """A component stepped by hand: all its input values in, all its output values out."""

    def __init__(self, component: Component):
        self.component = component
        self._step = _STEP(component.step_address)
        self._y = component.initial_outputs.copy()

    def __call__(self, u: NDArray[np.float64], t: float = 0.0, h: float = 2e-3) -> NDArray[np.float64]:
        u = np.ascontiguousarray(u, dtype=float)
        assert len(u) == width(self.component.inputs)
        assert self._step(self.component.self_address, t, h, u.ctypes.data, self._y.ctypes.data) == 0
        return self._y.copy()

    def named(self, u: NDArray[np.float64], t: float = 0.0, h: float = 2e-3) -> dict[str, NDArray[np.float64]]:
        """The outputs by port."""
        sizes = np.cumsum([port.size for port in self.component.outputs])
        values = np.split(self(u, t, h), sizes[:-1])
        return {port.name: value for port, value in zip(self.component.outputs, values, strict=True)}
