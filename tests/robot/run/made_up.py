"""Runs in memory that no robot made."""

from collections.abc import Mapping
from typing import Any

import numpy as np
from numpy.typing import NDArray

from twin.kernel.cosim.component import Component
from twin.kernel.cosim.port import Port
from twin.kernel.cosim.simulation import Simulation
from twin.kernel.cosim.system import System
from twin.robot.run.trace import Trace


def made_up(signals: Mapping[str, NDArray[Any]], units: Mapping[str, str] | None = None) -> Trace:
    """A run of 1 ms ticks; signals (n,) or (n, k) by name, of one length."""
    columns = {name: np.asarray(values, dtype=float).reshape(len(values), -1) for name, values in signals.items()}
    ports: dict[str, list[Port]] = {}
    for name, values in columns.items():
        component, _, port = name.replace("drive/", "drive_").partition(".")
        ports.setdefault(component, []).append(Port(port, values.shape[1], (units or {}).get(name, "1")))
    system = System([silent(name, tuple(own)) for name, own in ports.items()], [], 1e-3)
    rows = np.zeros((len(next(iter(columns.values()), ())), system.outputs_width))
    for name, values in columns.items():
        rows[:, system.columns(name.replace("drive/", "drive_"))] = values
    trace = Trace()
    trace.begin(Simulation(system, len(rows) - 1))
    trace.on_rows(0, rows, [])
    return trace


def silent(name: str, outputs: tuple[Port, ...]) -> Component:
    """A component that is never stepped."""
    return Component(name, (), outputs, True, 0, 0, np.zeros(sum(port.size for port in outputs)))
