"""Observer that finds the tick of the safety monitor's first intervention.

Up to that tick, a run without the monitor is bit-identical.
"""

import math

import numpy as np

from twin.kernel.cosim.observers import Observer, TickEvent
from twin.kernel.cosim.simulation import Simulation
from twin.robot.assembly.drives import ENABLE_ROLE


class MonitorWork(Observer):
    """Observer of the safety monitor's effect: finds the first tick with an effect on the robot.

    The monitor is idle while its output command equals its input bit for bit and the power stays on. If nothing else
    reads more of it than command and power, all other signals then equal a run without it, by induction over
    ticks. A drive with an enable input is called differently if there is a monitor, so there the tick is 0.

    Args:
        past: observer of the run whose state this run continues.

    Attributes:
        first: first tick of a possible difference to the run without monitor; infinity without one.
    """

    def __init__(self, past: "MonitorWork | None" = None):
        self.first = math.inf
        self._past = past

    @property
    def idle(self) -> bool:
        """Whether the safety monitor never affected the robot during the run."""
        return self.first == math.inf

    def begin(self, simulation: Simulation) -> None:
        system = simulation.system
        monitor = system.component("monitor")
        start = int(system.u_start[system.components.index(monitor)])
        inputs = np.concatenate([np.full(port.size, port.name == "omega_ref") for port in monitor.inputs])
        self._given = system.sources[start : start + len(inputs)][inputs]
        self._gives, self._power = system.columns("monitor.omega_ref"), system.columns("monitor.power").start
        own = int(system.y_start[system.components.index(monitor)])
        read = system.sources[(system.sources >= own) & (system.sources < own + len(monitor.initial_outputs))]
        passed = [*range(self._gives.start, self._gives.stop), self._power]
        switched = any(port.name == ENABLE_ROLE for component in system.components for port in component.inputs)
        if switched or not set(read.tolist()) <= set(passed):
            self.first = 0
        elif self._past is not None and self._past.first < simulation.next_tick:
            self.first = self._past.first

    def on_rows(self, first: int, rows: np.ndarray, events: list[TickEvent]) -> None:
        if self.first == math.inf:
            given, gives = (np.ascontiguousarray(rows[:, c]).view(np.int64) for c in (self._given, self._gives))
            works = np.any(given != gives, axis=1) | (rows[:, self._power] != 1.0)
            self.first = first + int(np.argmax(works)) if works.any() else math.inf
