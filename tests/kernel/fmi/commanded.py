"""A drive at a command that is a function of time."""

from collections.abc import Callable
from typing import Any

import numpy as np

from tests.kernel.fmi.test_component import TICK
from twin.kernel.cosim.port import Port
from twin.kernel.cosim.python_class import PythonComponent
from twin.kernel.cosim.simulation import Simulation
from twin.kernel.cosim.system import System


class Source:
    """A command that is a function of time: of that at a tick if sampled, else of that at the end of a step."""

    inputs = ()
    outputs = (Port("omega_ref", 1, "rad/s"), Port("tau_load", 1, "N m"))

    def __init__(self, command: Callable[[float], float], sampled: bool):
        self.command, self.sampled = command, sampled

    def step(self, t: float, h: float, u: np.ndarray, y: np.ndarray) -> None:
        y[:] = self.command(t if self.sampled else t + h), 0.0


def stepped(component: Any, command: Callable[[float], float], ticks: int, **coupling: Any) -> dict[str, np.ndarray]:
    """What a drive does at a command that is a function of time, sampled at each tick."""
    source = PythonComponent("source", Source(command, sampled="inputs" not in coupling))
    wires = [(f"source.{p.name.partition(':')[0]}", f"{component.name}.{p.name}") for p in component.inputs]
    system = System([source, component], wires, TICK, **coupling)
    try:
        rows = Simulation(system, ticks).run()
    finally:
        component.close()
    return {p.name: rows[:, system.columns(f"{component.name}.{p.name}")][:, 0] for p in component.outputs}
