"""The past that several runs share: a run that is made once, and others that go on from its states.

Nothing is assembled for those. Each is a system of the same components, which are put where they were in the last
state before anything differs, and of the faults that only this run has, which come in there as in a branch. What an
experiment says of components, and a run has changed (faults and changes do), is put back before each run.

It is looked at whether states bring the same future back, once for each past. Where they do not, or a component has
none, every run is made from the start: the same numbers, later.
"""

import math
from bisect import bisect_right
from collections.abc import Callable, Collection, Mapping, Sequence
from dataclasses import replace

import numpy as np

from twin.kernel.cosim.component import Component, NativeComponent
from twin.kernel.cosim.observers import MAX_SLICE, Observer, SimulationResult, simulate, step_until
from twin.kernel.cosim.simulation import Simulation
from twin.kernel.cosim.state import SystemState, stateless_reasons
from twin.kernel.cosim.system import System
from twin.kernel.errors import ComponentFailed
from twin.robot.assembly.assemble import Assembly, assemble, assemble_system
from twin.robot.assembly.build import motions
from twin.robot.experiment.experiment import Experiment
from twin.robot.experiment.fault import FAULT_KINDS, NO_END_TICK, Fault
from twin.robot.plant.surface_motion import Body
from twin.robot.run.branch import add_components
from twin.robot.run.trace import Trace

MAX_STATES = 64
"""So many of a run are kept in memory, some kilobytes each, evenly over it: the way from one to a tick is short."""
SHARING_DISABLED = "sharing is switched off"


IDLE_FAULT_KINDS = {"body": "surface_jump", "drive": "drive_runaway"}
"""By the mechanism of faults that are seen before they act, one of them."""


def prefix_experiment(experiment: Experiment) -> Experiment:
    """The run whose past `experiment` has: without its faults, or with such as never act.

    A surface that will move has a body from the start. A shaft behind a drive is a continuous component more: where
    these do not see each other's newest outputs as they are, what passes through it is late.
    """
    cosim = experiment.cosim
    passed_on = cosim.scheme == "gauss_seidel" and cosim.inputs == "hold" and cosim.iterations == 1
    idle = []
    for fault in experiment.faults:
        mechanism = FAULT_KINDS[fault.kind].mechanism
        if mechanism == "body" or (mechanism == "drive" and not passed_on):
            idle.append(Fault(IDLE_FAULT_KINDS[mechanism], fault.target, onset=NO_END_TICK))
    return replace(experiment, faults=tuple(idle))


class SharedPrefix:
    """A run, and others with the same past; a context manager that frees what it keeps.

    Args:
        experiment: of the run; its faults never act, see `prefix_experiment`.
        observers: of the run.
        share: False: every run is made from the start, for comparison.

    Attributes:
        lacking: why runs are made from the start, as a sentence; "" if they are not.

    Raises:
        InputRefused: a part of the robot does not fit.
    """

    def __init__(self, experiment: Experiment, observers: Sequence[Observer] = (), share: bool = True):
        self.experiment = experiment
        self.lacking = "" if share else SHARING_DISABLED
        self._assembly: Assembly | None = None
        self._states: list[SystemState] = []
        if share:
            self._make(observers)

    def __enter__(self) -> "SharedPrefix":
        return self

    def __exit__(self, *failure: object) -> None:
        self.close()

    def close(self) -> None:
        """Free states and components; safe to call twice."""
        for state in self._states:
            state.close()
        self._states = []
        assembly, self._assembly = self._assembly, None
        if assembly is not None:
            assembly.close()

    def run_variant(self, experiment: Experiment, tick: int, observers: Sequence[Observer]) -> SimulationResult:
        """Run `experiment`, which does not differ from that of the past before `tick`.

        Args:
            experiment: its faults and changes alone may be other ones; its duration too.
            tick: the first at which anything may be other.
            observers: see the last kept state as the beginning; of a run from the start, tick 0.

        Returns:
            The run. What its components hold is there until the next one.

        Raises:
            InputRefused: a part of the robot, or a fault, does not fit.
        """
        if not self.lacking and self._assembly is None:
            self._make()
        if self.lacking or self._assembly is None:
            with assemble(experiment) as assembly:
                return simulate(assembly, experiment.duration_ticks, observers)
        state = self._states[bisect_right(self._states, tick, key=lambda state: state.tick) - 1]
        for component, memory in self._as_made:
            component.memory[...] = memory
        system = assemble_system(experiment, self._parts(experiment, self._assembly))

        def start(simulation: Simulation) -> None:
            self._simulation.restore(state)
            new = simulation.copy_from(self._simulation)
            if simulation.next_tick > 0:
                add_components(simulation, new)

        done = simulate(replace(self._assembly, system=system), experiment.duration_ticks, observers, start=start)
        if done.failure and system.component(done.simulation.culprit).holders():
            # what is inside an FMU that has failed is nothing to go back with
            self.close()
        return done

    def _make(self, observers: Sequence[Observer] = ()) -> None:
        self._assembly = assembly = assemble(self.experiment)
        components = assembly.system.components
        self.lacking = "; ".join(stateless_reasons(components, portable=False))
        self._as_made = [(one, one.memory.copy()) for one in components if isinstance(one, NativeComponent)]
        if not self.lacking:
            try:
                self._run_prefix(observers)
            except ComponentFailed as problem:
                self.lacking = str(problem)
        if self.lacking:
            self.close()

    def _run_prefix(self, observers: Sequence[Observer]) -> None:
        """Make the run and its states, and look whether one of them brings the same future back.

        Raises:
            ComponentFailed: an FMU refuses, or a component failed.
        """
        assert self._assembly is not None
        last = self.experiment.duration_ticks
        keeper = _StateRecorder(last, self._states)
        done = simulate(self._assembly, last, [keeper, *observers]).require_success()
        self._simulation = done.simulation
        if not reproduces(self._simulation, self._states[len(self._states) // 2 :]):
            self.lacking = "from a state that was kept, a component goes on to other numbers"

    def _parts(self, experiment: Experiment, assembly: Assembly) -> Mapping[str, list[Component]]:
        """The components of `assembly` by row, with the surface of `experiment`, which has no state."""
        own = bool(assembly.components_by_row["body"]) and "body" not in assembly.third_party
        return (
            {**assembly.components_by_row, "body": [Body(motions(experiment))]} if own else assembly.components_by_row
        )


def reproduces(simulation: Simulation, states: Sequence[SystemState]) -> bool:
    """Whether the first of `states`, which were taken one after the other, brings all the others back."""
    simulation.restore(states[0])
    for state in states:
        while simulation.next_tick < state.tick and not simulation.is_over:
            simulation.advance(state.tick - simulation.next_tick)
        again = simulation.state()
        same = again.tick == state.tick and np.array_equal(again.memory, state.memory)
        again.close()
        if not same:
            return False
    return True


def simulate_variants(
    make: Callable[[], Assembly],
    at: int,
    last: int,
    only: Collection[str],
    ways: Sequence[Callable[[System], None]],
    watch: Callable[[System], Sequence[Observer]] = lambda system: (),
    slice_ticks: int = MAX_SLICE,
) -> list[tuple[SimulationResult, Trace]]:
    """Run a system once for each of `ways`, which change it at tick `at`.

    Args:
        make: assembles the system.
        at: tick of the change.
        last: tick that gets the last row.
        only: signals that are kept, see `Trace`.
        ways: change the system at the beginning of tick `at`.
        watch: further observers of a system's run.
        slice_ticks: see `simulate`.

    Returns:
        Per way the simulation and its trace; shorter on failure or if an observer stopped it.

    Raises:
        InputRefused: a part of the robot does not fit.
    """
    found = []
    for way in ways:
        with make() as assembly:
            simulation, trace = Simulation(assembly.system, last, slice_ticks), Trace(only=only)
            observers = [*watch(assembly.system), trace]
            for observer in observers:
                observer.begin(simulation)
            done = step_until(simulation, observers, at)
            if simulation.next_tick >= at:
                way(assembly.system)
                done = step_until(simulation, observers, last + 1)
            found.append((done, trace))
    return found


class _StateRecorder(Observer):
    """Keeps states on the way to tick `last`, in a list."""

    def __init__(self, last: int, states: list[SystemState]):
        self.halts = range(0, last + 1, math.ceil((last + 1) / MAX_STATES))
        self._states = states

    def begin(self, simulation: Simulation) -> None:
        self._simulation = simulation

    def ready(self, tick: int) -> None:
        if tick in self.halts:
            self._states.append(self._simulation.state())
