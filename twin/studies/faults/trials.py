"""Runs of the matrix: of each fault one with the safety monitor and one without.

They go on from the last state of the healthy run before the fault. Until the monitor does something the robot without
it is the same one, to the last bit: one that never does anything saves the second run.
"""

from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import Self

import numpy as np
from numpy.typing import NDArray

from twin.robot.experiment.experiment import Experiment
from twin.robot.experiment.fault import Fault
from twin.robot.monitor.checks import Trip
from twin.robot.run.runs import Outcome, RunRequest, Runs

SIGNALS = ("plant.F_ee_B", "plant.p_B")
PASTS = 4
"""Number of pasts of one experiment: with and without the monitor, with and without a surface that moves."""


@dataclass(frozen=True)
class FaultTrial:
    """A run that is over: what truly happened to the person, and what the monitor did about it.

    Attributes:
        force: true contact force |plant.F_ee_B| (N), (ticks,); fewer ticks than planned if a component failed.
        z: true height plant.p_B[2] (m), (ticks,).
        trip: of the monitor; None if it did not trip, or there is none.
        power_off_tick: when the monitor took the power; None if it did not.
        failure: the sentence that ended the run; "" if it went to its end.
        culprit: the component that failed; "" if none did.
    """

    force: NDArray[np.float64]
    z: NDArray[np.float64]
    trip: Trip | None
    power_off_tick: int | None
    failure: str
    culprit: str


def healthy_run(experiment: Experiment) -> FaultTrial:
    """`experiment`, which has no faults, run in memory.

    Raises:
        InputRefused: a part of the robot does not fit.
    """
    return fault_trial(Runs(RunRequest(frozenset(SIGNALS)), most=0).run(experiment))


def fault_trial(run: Outcome) -> FaultTrial:
    """What became of a run that has kept force and position."""
    assert run.trace is not None
    return FaultTrial(
        force=np.linalg.norm(run.trace["plant.F_ee_B"], axis=1),
        z=run.trace["plant.p_B"][:, 2],
        trip=run.trip,
        power_off_tick=run.power_off_tick,
        failure=str(run.failure or ""),
        culprit=run.culprit,
    )


class Trials:
    """Makes the runs; a context manager that frees what they share.

    Args:
        experiment: without faults, with the monitor of twin.
        share: False: every run is made from the start, for comparison. The numbers are the same.
        only: the signals that are kept of a run.
    """

    def __init__(self, experiment: Experiment, share: bool = True, only: Sequence[str] = SIGNALS):
        self._experiment, self._share = experiment, share
        self._runs = Runs(RunRequest(frozenset(only), idle=True), most=PASTS if share else 0)

    def __enter__(self) -> Self:
        return self

    def __exit__(self, *failure: object) -> None:
        self.close()

    def close(self) -> None:
        """Free what the runs share; a run after that makes it again."""
        self._runs.close()

    def pair(self, fault: Fault) -> tuple[FaultTrial, FaultTrial]:
        """The run with `fault` as its only one and the monitor, and that without the monitor.

        Raises:
            InputRefused: a drive FMU or the fault does not fit.
        """
        watched = self.run((fault,))
        trial = fault_trial(watched)
        return trial, trial if self.serves_unwatched(watched) else fault_trial(self.run((fault,), watched=False))

    def serves_unwatched(self, watched: Outcome) -> bool:
        """Whether the run without monitor has the bits of `watched`."""
        # the sentence of a failure may name what is asked of the monitor
        return self._share and watched.idle and watched.failure is None

    def run(self, faults: Sequence[Fault], watched: bool = True) -> Outcome:
        """The run with `faults`, with the monitor or without.

        Raises:
            InputRefused: a drive FMU or a fault does not fit.
        """
        monitor = self._experiment.monitor if watched else None
        return self._runs.run(replace(self._experiment, faults=tuple(faults), monitor=monitor))
