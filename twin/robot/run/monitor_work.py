"""The tick at which the safety monitor first acts; until then the robot without monitor has the same bits."""

import math

import numpy as np

from twin.kernel.cosim.observers import Observer, TickEvent
from twin.kernel.cosim.simulation import Simulation
from twin.robot.assembly.drives import ENABLE_ROLE


class MonitorWork(Observer):
    """Finds out when the monitor first does something to the robot.

    It does nothing as long as it passes on the very command that it is given, at every tick, and leaves the power on:
    by induction over the ticks everything else has then the bits that it has without the monitor, if nothing reads
    more of it than command and power. A drive that can be switched is called in another way where there is a monitor.

    Args:
        past: that of the run from which this one goes on.

    Attributes:
        first: the tick from which on the robot without monitor may be another one; infinity: never.
    """

    def __init__(self, past: "MonitorWork | None" = None):
        self.first = math.inf
        self._past = past

    @property
    def idle(self) -> bool:
        """Whether the robot without monitor is the same one to the end."""
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
