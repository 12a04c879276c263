"""Runs that share a prefix: it is simulated once, and the variants continue from its saved states.

Variants are not assembled again. Each is a system of the same components, restored to the last state before the
first difference, plus the variant's own faults, added as in a branch. Component parameters that a variant changed
(by faults or scheduled changes) are restored before the next one.

Whether a restored state reproduces the rest of the prefix is checked once per prefix. If it does not, or if a
component cannot save its state, `lacking` states the reason, and `Runs` makes every run from the start.
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
"""Maximum number of states kept in memory, some kilobytes each, evenly spaced so that any tick is near one."""
IDLE_FAULT_KINDS = {"body": "surface_jump", "drive": "drive_runaway"}
"""Idle stand-in by fault mechanism, for faults whose components are present before they act."""


def prefix_experiment(experiment: Experiment) -> Experiment:
    """Return the experiment without its faults, or with idle ones, whose run all of its variants share.

    A surface that will move has a body from the start. A fault of a drive adds a continuous component: where such
    components do not see each other's newest outputs directly, it delays the signals that pass through it.
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
    """The simulated beginning that several variants of a run share, and their runs; `close` it at the end.

    Faults of its experiment never act, see `prefix_experiment`. `lacking` is the reason why no run can share it; "" if
    runs can.
    """

    def __init__(self, experiment: Experiment, observers: Sequence[Observer] = ()):
        self.experiment = experiment
        self._assembly: Assembly | None = None
        self._states: list[SystemState] = []
        self._make(observers)

    def close(self) -> None:
        """Free the shared states and components; safe to call twice."""
        for state in self._states:
            state.close()
        self._states = []
        assembly, self._assembly = self._assembly, None
        if assembly is not None:
            assembly.close()

    def make_ready(self) -> bool:
        """Whether variants can continue from the prefix; it is simulated again if the last one ended with a failure."""
        if not self.lacking and self._assembly is None:
            self._make()
        return not self.lacking

    def run_variant(self, experiment: Experiment, tick: int, observers: Sequence[Observer]) -> SimulationResult:
        """Run a variant that equals the shared prefix before `tick`, from the last saved state; it must be ready.

        The variant differs from the prefix in faults, scheduled changes and duration only. The simulation's component
        memory is valid until the next run.
        """
        assert self._assembly is not None
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
            # the instance of a failed FMU cannot be restored
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
        """Simulate the shared prefix, keep its states, and check that a restored state reproduces the rest."""
        assert self._assembly is not None
        last = self.experiment.duration_ticks
        keeper = _StateRecorder(last, self._states)
        done = simulate(self._assembly, last, [keeper, *observers]).require_success()
        self._simulation = done.simulation
        if not reproduces(self._simulation, self._states[len(self._states) // 2 :]):
            self.lacking = "a component does not reproduce its numbers from a saved state"

    def _parts(self, experiment: Experiment, assembly: Assembly) -> Mapping[str, list[Component]]:
        """Return the prefix's components by row, with the variant's own motions of the surface."""
        own = bool(assembly.components_by_row["body"]) and "body" not in assembly.third_party
        return (
            {**assembly.components_by_row, "body": [Body(motions(experiment))]} if own else assembly.components_by_row
        )


def reproduces(simulation: Simulation, states: Sequence[SystemState]) -> bool:
    """Whether a simulation that continues from the first saved state gives all later states again."""
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
) -> list[Trace]:
    """Run a system several times, changed at the beginning of tick `at` by a different function of `ways` each time.

    Return the trace per way, up to tick `last`; shorter on failure or if an observer stopped the run.
    `watch` returns further observers of a system's run.
    """
    found = []
    for way in ways:
        with make() as assembly:
            simulation, trace = Simulation(assembly.system, last, slice_ticks), Trace(only=only)
            observers = [*watch(assembly.system), trace]
            for observer in observers:
                observer.begin(simulation)
            step_until(simulation, observers, at)
            if simulation.next_tick >= at:
                way(assembly.system)
                step_until(simulation, observers, last + 1)
            found.append(trace)
    return found


class _StateRecorder(Observer):
    """Observer that keeps up to `MAX_STATES` evenly spaced states of a run, up to tick `last`."""

    def __init__(self, last: int, states: list[SystemState]):
        self.halts = range(0, last + 1, math.ceil((last + 1) / MAX_STATES))
        self._states = states

    def begin(self, simulation: Simulation) -> None:
        self._simulation = simulation

    def ready(self, tick: int) -> None:
        if tick in self.halts:
            self._states.append(self._simulation.state())
