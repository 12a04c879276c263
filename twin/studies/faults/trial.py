"""One run in memory: what truly happened to the person, and what the monitor did about it."""

import dataclasses
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from twin.experiment.experiment import Experiment
from twin.experiment.fault import Fault
from twin.monitor.reasons import Trip
from twin.runs.assembly.assemble import assemble
from twin.runs.loop import Simulated, simulate
from twin.runs.trace import Trace


@dataclass(frozen=True)
class FaultTrial:
    """A run that is over.

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


def trial(experiment: Experiment, fault: Fault | None, watched: bool) -> FaultTrial:
    """Run `experiment` with `fault` as its only one (None: with none), with its monitor or without.

    Raises:
        InputRefused: a drive FMU or the fault does not fit.
    """
    faults = () if fault is None else (fault,)
    monitor = experiment.monitor if watched else None
    run = Trace(only=("plant.F_ee_B", "plant.p_B"))
    with assemble(dataclasses.replace(experiment, faults=faults, monitor=monitor)) as assembly:
        done = simulate(assembly, experiment.duration_ticks, [run])
    return fault_trial_of(run, done)


def fault_trial_of(run: Trace, done: Simulated) -> FaultTrial:
    """What became of a run that has kept force and position."""
    return FaultTrial(
        force=np.linalg.norm(run["plant.F_ee_B"], axis=1),
        z=run["plant.p_B"][:, 2],
        trip=done.monitor.trip if done.monitor else None,
        power_off_tick=done.monitor.power_off_tick if done.monitor else None,
        failure=str(done.failure or ""),
        culprit=done.simulation.culprit,
    )
