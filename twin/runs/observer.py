"""Whoever looks on while the robot is simulated, and what is told of what happens."""

from typing import Literal, NamedTuple

import numpy as np

from twin.cosim.simulation import Simulation

Level = Literal["DEBUG", "INFO", "WARNING", "ERROR"]


class TickEvent(NamedTuple):
    """Something that happened at a tick: how much it matters, what, and in which component."""

    tick: int
    level: Level
    text: str
    source: str


class Observer:
    """Sees a simulation slice by slice. By itself it does nothing: a kind of observer overrides what it needs.

    The thread that steps calls all observers of a simulation in their order, between slices: what they take their time
    over delays the run. None may write into rows.

    Attributes:
        enough: asked after every slice: whether the simulation may end before its time.
    """

    enough = False

    def begin(self, simulation: Simulation) -> None:
        """`simulation` runs as soon as all observers have returned from this."""

    def ready(self, tick: int) -> None:
        """The slice from `tick` on is next: what is now written into a component's memory acts from that tick on."""

    def take(self, first: int, rows: np.ndarray, events: list[TickEvent]) -> None:
        """A slice is over.

        Args:
            first: tick of the first row.
            rows: (n, width of the system's outputs), overwritten by the next slice; fewer than in other slices at the
                end, none if a component failed in its first tick.
            events: what happened in it as far as the observers before this one found out, by ascending ticks; one that
                finds more puts it in.
        """
