"""A run that nobody records: its rows, or those of every so many ticks."""

import time
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from twin.assembly.assemble import assemble
from twin.cosim.simulation import Simulation
from twin.cosim.system import System
from twin.experiment.experiment import Experiment

MOST_ROWS = 100
"""Of a slice, kept or not."""


@dataclass(frozen=True)
class Rows:
    """A finished run: `rows["plant.F_ee_B"]` is (rows, 3), a port of size 1 (rows,).

    Attributes:
        system: whose outputs they are; its components are closed.
        values: (rows, outputs). period: time between two rows (s). stepping: wall time in the master (s).
    """

    system: System
    values: NDArray[np.float64]
    period: float
    stepping: float

    def __getitem__(self, end: str) -> NDArray[np.float64]:
        columns = self.values[:, self.system.columns(end)]
        return columns.squeeze(axis=1) if columns.shape[1] == 1 else columns

    @property
    def t(self) -> NDArray[np.float64]:
        return np.arange(len(self.values), dtype=float) * self.period


def rows_of(experiment: Experiment, every: int = 1) -> Rows:
    """Run `experiment` in this process and keep the row of every `every`-th tick, tick 0 first.

    Raises:
        InputRefused: a drive FMU does not fit. ComponentFailed: a component failed.
    """
    with assemble(experiment) as assembly:
        slice_ticks = every * max(1, MOST_ROWS // every)
        simulation = Simulation(assembly.system, experiment.duration_ticks, slice_ticks)
        began, kept = time.perf_counter(), []
        while not simulation.finished:
            kept.append(simulation.advance()[::every].copy())
        stepping = time.perf_counter() - began
        if simulation.failure:
            raise simulation.failure
    return Rows(assembly.system, np.concatenate(kept), every * experiment.cosim.tick, stepping)
