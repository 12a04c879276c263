"""Runs of the matrix: of each fault one with the safety monitor and one without.

They go on from the last state of the healthy run before the fault. Until the monitor does something the robot without
it is the same one, to the last bit: one that never does anything saves the second run.
"""

import math
from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import NamedTuple, Self

import numpy as np
from numpy.typing import NDArray

from twin.kernel.cosim.observers import Observer, Simulated, TickEvent, simulate
from twin.kernel.cosim.simulation import Simulation
from twin.robot.assembly.assemble import assemble
from twin.robot.assembly.drives import ENABLE
from twin.robot.experiment.experiment import Experiment
from twin.robot.experiment.fault import Fault
from twin.robot.monitor.checks import Trip
from twin.robot.monitor.component import own_monitor
from twin.robot.run.past import SharedPast, before_fault
from twin.robot.run.trace import Trace

SIGNALS = ("plant.F_ee_B", "plant.p_B")


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
    run = Trace(only=SIGNALS)
    with assemble(experiment) as assembly:
        return fault_trial_of(run, simulate(assembly, experiment.duration_ticks, [run]))


def fault_trial_of(run: Trace, done: Simulated) -> FaultTrial:
    """What became of a run that has kept force and position."""
    monitor = own_monitor(done.simulation.system)
    return FaultTrial(
        force=np.linalg.norm(run["plant.F_ee_B"], axis=1),
        z=run["plant.p_B"][:, 2],
        trip=monitor.trip if monitor else None,
        power_off_tick=monitor.power_off_tick if monitor else None,
        failure=str(done.failure or ""),
        culprit=done.simulation.culprit,
    )


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
        switched = any(port.name == ENABLE for component in system.components for port in component.inputs)
        if switched or not set(read.tolist()) <= set(passed):
            self.first = 0
        elif self._past is not None and self._past.first < simulation.next_tick:
            self.first = self._past.first

    def take(self, first: int, rows: np.ndarray, events: list[TickEvent]) -> None:
        if self.first == math.inf:
            given, gives = (np.ascontiguousarray(rows[:, c]).view(np.int64) for c in (self._given, self._gives))
            works = np.any(given != gives, axis=1) | (rows[:, self._power] != 1.0)
            self.first = first + int(np.argmax(works)) if works.any() else math.inf


class _Past(NamedTuple):
    """Of a robot before a fault: its past, what was kept of it, what its monitor did, and faults that never act."""

    shared: SharedPast
    run: Trace
    work: MonitorWork
    faults: tuple[Fault, ...]


class TrialRun(NamedTuple):
    """A run of `Trials`.

    Attributes:
        trace: what was kept of it, from tick 0 on.
        done: the simulation.
        idle: whether the monitor never did anything to the robot.
    """

    trace: Trace
    done: Simulated
    idle: bool


class Trials:
    """Makes the runs; a context manager that frees what they share.

    Args:
        experiment: without faults, with the monitor of twin.
        share: False: every run is made from the start, for comparison. The numbers are the same.
        only: the signals that are kept of a run.
    """

    def __init__(self, experiment: Experiment, share: bool = True, only: Sequence[str] = SIGNALS):
        self._experiment, self._share, self._only = experiment, share, only
        self._pasts: dict[bool, _Past] = {}

    def __enter__(self) -> Self:
        return self

    def __exit__(self, *failure: object) -> None:
        self.close()

    def pair(self, fault: Fault) -> tuple[FaultTrial, FaultTrial]:
        """The run with `fault` as its only one and the monitor, and that without the monitor.

        Raises:
            InputRefused: a drive FMU or the fault does not fit.
        """
        watched = self.run((fault,))
        trial = fault_trial_of(watched.trace, watched.done)
        if self.serves_unwatched(watched):
            return trial, trial
        unwatched = self.run((fault,), watched=False)
        return trial, fault_trial_of(unwatched.trace, unwatched.done)

    def serves_unwatched(self, watched: TrialRun) -> bool:
        """Whether the run without monitor has the bits of `watched`."""
        # the sentence of a failure may name what is asked of the monitor
        return self._share and watched.idle and not watched.done.failure

    def run(self, faults: Sequence[Fault], watched: bool = True) -> TrialRun:
        """The run with `faults`, with the monitor or without; what it holds is there until the next one.

        Raises:
            InputRefused: a drive FMU or a fault does not fit.
        """
        monitor = self._experiment.monitor if watched else None
        experiment = replace(self._experiment, faults=tuple(faults), monitor=monitor)
        past = self._past(experiment, watched)
        trace, work = Trace(only=self._only, past=past.run), MonitorWork(past.work)
        onset = min((fault.onset for fault in faults), default=experiment.duration_ticks)
        done = past.shared.go_on(experiment, onset, self._observers(trace, work, watched))
        return TrialRun(trace, done, work.first == math.inf)

    def _past(self, experiment: Experiment, watched: bool) -> _Past:
        before = before_fault(experiment)
        if before.faults and len(experiment.faults) > 1:
            # which of the faults an idle one stands for is known of a single one only
            return _Past(SharedPast(before, share=False), Trace(only=self._only), MonitorWork(), before.faults)
        if any(past.faults != before.faults for past in self._pasts.values()):
            self.close()
        if watched not in self._pasts:
            run, work = Trace(only=self._only), MonitorWork()
            shared = SharedPast(before, self._observers(run, work, watched), self._share)
            self._pasts[watched] = _Past(shared, run, work, before.faults)
        return self._pasts[watched]

    @staticmethod
    def _observers(run: Trace, work: MonitorWork, watched: bool) -> Sequence[Observer]:
        return [run, work] if watched else [run]

    def close(self) -> None:
        """Free what the runs share; a run after that makes it again."""
        # the last one first: drives in processes of their own leave the processor to those before them
        for past in reversed(self._pasts.values()):
            past.shared.close()
        self._pasts = {}
