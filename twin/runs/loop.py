"""The one loop: an assembled robot, stepped slice by slice before its observers."""

import time
from collections.abc import Sequence
from dataclasses import dataclass
from typing import Protocol, Self

from twin.cosim.component import Component
from twin.cosim.port import by_port
from twin.cosim.simulation import Simulation
from twin.cosim.system import System
from twin.errors import ComponentFailed
from twin.monitor.component import SafetyMonitor
from twin.monitor.reasons import trip_sentence
from twin.runs.observer import Observer, TickEvent

LONG_SLICE = 1000
"""Ticks. Where nobody waits for a slice it may be long; but its rows are to stay in the processor's cache."""


def other_trip(monitor: Component) -> str:
    """What is to be said of a trip of a monitor of another make."""
    return f"safety monitor: {monitor.label or monitor.name} has tripped; why, its output 'reason' may say"


class Assembled(Protocol):
    """What has a system."""

    @property
    def system(self) -> System:
        """To be stepped."""


@dataclass(frozen=True)
class Simulated:
    """A simulation that is over.

    Attributes:
        simulation: how far it came, and what ended it too early, if anything did.
        stepping: wall time in the master (s).
        monitor: twin's own; None if nobody watches, or one of another make.
    """

    simulation: Simulation
    stepping: float
    monitor: SafetyMonitor | None

    @property
    def failure(self) -> ComponentFailed | None:
        return self.simulation.failure

    def completed(self) -> Self:
        """The same, of a simulation in which no component failed.

        Raises:
            ComponentFailed: one did.
        """
        if self.failure:
            raise self.failure
        return self

    @property
    def trip(self) -> str:
        """Why the safety monitor tripped; "" if it did not."""
        if self.monitor:
            return trip_sentence(self.monitor.trip) if self.monitor.trip else ""
        if not self.simulation.system.has("monitor.tripped"):
            return ""
        other = self.simulation.system.component("monitor")
        tripped = by_port(other.outputs, self.simulation.outputs(other))["tripped"][0] != 0.0
        return other_trip(other) if tripped else ""

    @property
    def costs(self) -> dict[str, float]:
        """Wall time per tick of each component (s), by its name; {} if they were not timed."""
        cycles, ticks = self.simulation.cycles, max(1, self.simulation.next_tick)
        share = self.stepping / max(1, cycles.sum()) / ticks
        return {c.name: float(n * share) for c, n in zip(self.simulation.system.components, cycles, strict=False)}


def simulate(
    assembly: Assembled,
    last_tick: int,
    observers: Sequence[Observer] = (),
    slice_ticks: int = LONG_SLICE,
    timed: bool = False,
) -> Simulated:
    """Step the robot from tick 0 until `last_tick`, a component fails, or one of the `observers` has seen enough.

    Args:
        assembly: freshly made; of other systems than the robot only that.
        last_tick: the tick that gets the last row and no step.
        observers: called in this order.
        slice_ticks: most ticks of a slice.
        timed: measure each component.
    """
    simulation = Simulation(assembly.system, last_tick, slice_ticks, timed)
    for observer in observers:
        observer.begin(simulation)
    stepping = 0.0
    while not simulation.finished and not any(observer.enough for observer in observers):
        first = simulation.next_tick
        for observer in observers:
            observer.ready(first)
        began = time.perf_counter()
        rows = simulation.advance()
        stepping += time.perf_counter() - began
        events: list[TickEvent] = []
        for observer in observers:
            observer.take(first, rows, events)
    monitor = next((c for c in assembly.system.components if isinstance(c, SafetyMonitor)), None)
    return Simulated(simulation, stepping, monitor)
