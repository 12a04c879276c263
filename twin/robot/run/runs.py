"""Runs of experiments in memory, one after the other; runs of the same past are continued from its states.

A study generates experiments, asks for a run of each, and reduces the outcomes. The next experiment may depend on the
last outcome.
"""

import math
from collections.abc import Callable, Mapping
from dataclasses import dataclass, field, replace
from typing import Literal, NamedTuple, Self

import numpy as np

from twin.kernel.cosim.observers import Observer, SimulationResult, TickEvent, simulate
from twin.kernel.cosim.simulation import Simulation
from twin.kernel.cosim.system import System
from twin.kernel.errors import ComponentFailed
from twin.robot.assembly.assemble import assemble
from twin.robot.assembly.drives import ENABLE_ROLE
from twin.robot.experiment.experiment import Experiment
from twin.robot.experiment.fault import FAULT_KINDS
from twin.robot.monitor.component import own_monitor, trip_reason
from twin.robot.monitor.reasons import Trip
from twin.robot.run.hold import HoldRequest
from twin.robot.run.measures import RunOutcome, Values, missing_measures
from twin.robot.run.outcome import Tally
from twin.robot.run.shared_prefix import SharedPrefix, prefix_experiment
from twin.robot.run.trace import Trace


class RunRequest(NamedTuple):
    """The data that a study keeps of each run in memory.

    Attributes:
        signals: signals of the trace, `topic.field` each; empty for no trace. None for all signals, including faults'
            own, which shared prefixes lack: every run is then made from the start.
        tally: whether to sum up the numbers.
        idle: whether to find out if the monitor ever acted.
        timed: whether to measure each component, in runs from the start.
        check: called with each experiment and its system before the first tick, to refuse unmeasurable ones.
    """

    signals: frozenset[str] | None = frozenset()
    tally: bool = False
    idle: bool = False
    timed: bool = False
    check: Callable[[Experiment, System], None] | None = None


@dataclass(frozen=True)
class Outcome:
    """The outcome of one run in memory, also of a failed one.

    Attributes:
        status: "done", "tripped" (by the safety monitor) or "failed" (a component failed).
        reason: the error message; "" if done.
        trace: signals, also of a failed run; None if not requested.
        numbers: measures of a completed run; None if not requested, or if it failed.
        trip, power_off_tick: trip of twin's own monitor, and tick at which it cut the power; None without one.
        idle: whether the monitor never acted on the robot; True if not requested.
        culprit: name of the component that failed; "".
        stepping: wall time in the master (s).
        costs: wall time per tick of each component (s), by name; empty if not timed.
    """

    status: Literal["done", "tripped", "failed"]
    reason: str
    trace: Trace | None
    numbers: RunOutcome | None
    trip: Trip | None
    power_off_tick: int | None
    idle: bool
    culprit: str
    failure: ComponentFailed | None
    stepping: float
    costs: Mapping[str, float] = field(default_factory=dict)

    @property
    def measures(self) -> Values:
        return self.numbers.measures if self.numbers else missing_measures("the run failed")

    def require_success(self) -> Self:
        """Return this outcome if no component failed, else raise the failure."""
        if self.failure:
            raise self.failure
        return self


class MonitorWork(Observer):
    """Observer of the safety monitor's effect: finds the `first` tick with an effect on the robot, else infinity.

    The monitor is idle while its output command equals its input bit for bit and the power stays on. If nothing else
    reads more of it than command and power, all other signals then equal a run without it, by induction over
    ticks. A drive with an enable input is called differently if there is a monitor, so there the tick is 0.

    `past` is the observer of the run whose state this run continues.
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


class _Watch:
    """The observers of one run in memory, which may continue the prefix observed by `past`."""

    def __init__(self, request: RunRequest, experiment: Experiment, past: "_Watch | None" = None):
        signals = request.signals
        self.trace: Trace | None = None
        self.work: MonitorWork | None = None
        self.tally: _SharedTally | None = None
        if signals != frozenset():
            self.trace = Trace(only=signals or (), past=past.trace if past else None)
        if request.idle and experiment.monitor:
            self.work = MonitorWork(past.work if past else None)
        if request.tally:
            self.tally = _SharedTally(HoldRequest.from_experiment(experiment), past.tally if past else None)
        check = _Check(request.check, experiment) if request.check else None
        self.observers: list[Observer] = [one for one in (check, self.trace, self.work, self.tally) if one is not None]

    def outcome(self, done: SimulationResult) -> Outcome:
        monitor, trip = own_monitor(done.simulation.system), trip_reason(done.simulation)
        return Outcome(
            status="failed" if done.failure else "tripped" if trip else "done",
            reason=str(done.failure or trip),
            trace=self.trace,
            numbers=self.tally.tally.outcome if self.tally and not done.failure else None,
            trip=monitor.trip if monitor else None,
            power_off_tick=monitor.power_off_tick if monitor else None,
            idle=self.work is None or self.work.idle,
            culprit=done.simulation.culprit,
            failure=done.failure,
            stepping=done.stepping,
            costs=done.costs,
        )


class _Check(Observer):
    """Observer that calls `RunRequest.check` before the first tick of a run."""

    def __init__(self, check: Callable[[Experiment, System], None], experiment: Experiment):
        self._check, self._experiment = check, experiment

    def begin(self, simulation: Simulation) -> None:
        self._check(self._experiment, simulation.system)


class _SharedTally(Observer):
    """Observer that sums up a run's measures, continued from the state of another run at the same tick."""

    tally: Tally

    def __init__(self, request: HoldRequest, past: "_SharedTally | None" = None):
        self._request, self._past = request, past
        self._states: dict[int, object] = {}

    def begin(self, simulation: Simulation) -> None:
        self.tally = Tally(simulation.system, self._request)
        self.tally.begin(simulation)
        if self._past is not None and simulation.next_tick > 0:
            self.tally.restore(self._past._states[simulation.next_tick])

    def ready(self, tick: int) -> None:
        if self._past is None:
            self._states[tick] = self.tally.state()

    def on_rows(self, first: int, rows: np.ndarray, events: list[TickEvent]) -> None:
        self.tally.on_rows(first, rows, events)


@dataclass
class _PrefixEntry:
    """A cached prefix that several runs share: its experiment, the number of its runs, its simulation and observers."""

    key: Experiment
    runs: int = 0
    shared: SharedPrefix | None = None
    watch: _Watch | None = None


class Runs:
    """Runs experiments in memory, reusing prefixes that several runs share; a context manager that frees them.

    Experiments that differ only in faults and changes share a prefix. It is simulated once, and each run continues
    from its last state before the first difference, bit-identical to a run from the start.

    Args:
        after: number of runs made from the start before their prefix is simulated, which takes as long as two runs.
        most: maximum number of prefixes kept, the last used ones; 0 to make every run from the start.
    """

    def __init__(self, request: RunRequest, after: int = 0, most: int = 2):
        self.request, self._after, self._most = request, after, most
        self._pasts: list[_PrefixEntry] = []

    def __enter__(self) -> Self:
        return self

    def __exit__(self, *failure: object) -> None:
        self.close()

    def close(self) -> None:
        """Free all shared prefixes and their states; a later run simulates them again."""
        # the newest first: drives in processes leave the processor to those before them
        while self._pasts:
            _free(self._pasts.pop())

    def run(self, experiment: Experiment) -> Outcome:
        """Run an experiment in memory and return its outcome, also if a component failed.

        Raises:
            InputRefused: a part of the robot, a fault or a change does not fit.
        """
        past = self._find_prefix(experiment)
        if past is None or past.shared is None or not past.shared.make_ready():
            return self._run_from_start(experiment)
        watch = _Watch(self.request, experiment, past.watch)
        later = [fault.onset for fault in experiment.faults] + [change.tick for change in experiment.changes]
        first = min(later, default=experiment.duration_ticks)
        return watch.outcome(past.shared.run_variant(experiment, first, watch.observers))

    def _run_from_start(self, experiment: Experiment) -> Outcome:
        watch, outcome, timed = _Watch(self.request, experiment), None, self.request.timed
        try:
            with assemble(experiment) as assembly:
                done = simulate(assembly, experiment.duration_ticks, watch.observers, timed=timed)
                outcome = watch.outcome(done)
        except ComponentFailed as failure:
            # a drive in a process of its own may crash when it is freed
            if outcome is None:
                raise
            return replace(outcome, status="failed", reason=str(failure), numbers=None, failure=failure)
        return outcome

    def _find_prefix(self, experiment: Experiment) -> _PrefixEntry | None:
        """Return the cached prefix that a run of `experiment` can continue, simulated if it pays; None without one."""
        base = replace(prefix_experiment(experiment), changes=())
        if not self._most or self.request.signals is None:
            return None
        if len(experiment.faults) > 1 and any(FAULT_KINDS[fault.kind].mechanism == "drive" for fault in base.faults):
            # which of several faults an idle shaft stands for is unknown
            return None
        noisy = base.plant.motor_noise > 0.0 or base.plant.joint_noise > 0.0
        # without settings that do not change its run
        key = replace(base, name="", title="", seed=base.seed if noisy else 0, measures=(), values={}, origins={})
        past = next((one for one in self._pasts if one.key == key), None) or _PrefixEntry(key)
        self._pasts = [one for one in self._pasts if one is not past] + [past]
        while len(self._pasts) > self._most:
            _free(self._pasts.pop(0))
        past.runs += 1
        if past.shared is None and past.runs > self._after:
            past.watch = _Watch(self.request, base)
            past.shared = SharedPrefix(base, past.watch.observers)
        return past


def _free(past: _PrefixEntry) -> None:
    if past.shared is not None:
        past.shared.close()
