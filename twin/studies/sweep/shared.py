"""Runs of a sweep that differ only in what acts later, faults and changes: they go on from one past.

A past is given up with the first run that has another one. Runs whose keys act from the start have none in common.
"""

from dataclasses import replace

import numpy as np

from twin.kernel.cosim.observers import Observer, Simulated, TickEvent
from twin.kernel.cosim.simulation import Simulation
from twin.robot.experiment.experiment import Experiment
from twin.robot.run.outcome import Tally
from twin.robot.run.past import SharedPast, before_fault

AFTER = 2
"""Runs in a row with the same past after which it is made: that takes about as long as two runs."""


class LastPast:
    """The past of the runs that came last; `close` frees what it keeps.

    Args:
        share: False: no run goes on from it, for comparison.
    """

    def __init__(self, share: bool = True) -> None:
        self._share, self._runs = share, 0
        self._before: Experiment | None = None
        self._past: SharedPast | None = None
        self._known = SummedUp()

    def run(self, experiment: Experiment) -> tuple[Simulated, Tally] | None:
        """`experiment`, and what it comes to; None: it is to be made from the start.

        Raises:
            InputRefused: a part of the robot, or a fault, does not fit.
        """
        later = [fault.onset for fault in experiment.faults] + [change.tick for change in experiment.changes]
        base = replace(before_fault(experiment), changes=())
        # what it was read from says no more than the rest
        before = replace(base, values={}, origins={})
        if before != self._before:
            self.close()
            self._before = before
        self._runs += 1
        if self._runs <= AFTER or not later or not self._share:
            return None
        if self._past is None:
            self._known = SummedUp()
            self._past = SharedPast(base, [self._known])
        tally = SummedUp(self._known)
        return self._past.go_on(experiment, min(later), [tally]), tally.tally

    def close(self) -> None:
        """Give the past up; safe to call twice."""
        past, self._past, self._before, self._runs = self._past, None, None, 0
        if past is not None:
            past.close()


class SummedUp(Observer):
    """A tally of a run that may begin where another one was.

    Args:
        past: of that one; None: nothing goes on from it.

    Attributes:
        tally: its own, from the beginning of the simulation on.
    """

    tally: Tally

    def __init__(self, past: "SummedUp | None" = None):
        self._past = past
        self._states: dict[int, object] = {}

    def begin(self, simulation: Simulation) -> None:
        self.tally = Tally(simulation.system)
        self.tally.begin(simulation)
        if self._past is not None and simulation.next_tick > 0:
            self.tally.restore(self._past._states[simulation.next_tick])

    def ready(self, tick: int) -> None:
        if self._past is None:
            self._states[tick] = self.tally.state()

    def take(self, first: int, rows: np.ndarray, events: list[TickEvent]) -> None:
        self.tally.take(first, rows, events)
