"""State of a run at one tick, as the start of its branches.

FMUs that cannot save their state are handed over alive: the run is repeated up to the tick for every branch.
"""

from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Any

from twin.kernel.cosim.component import Component
from twin.kernel.cosim.observers import Observer, simulate
from twin.kernel.cosim.simulation import Simulation
from twin.kernel.cosim.state import SavedState, stateless_reasons
from twin.kernel.errors import InputRefused
from twin.kernel.process.states import StoredState, stored_state
from twin.kernel.recording.recorder import EventLog
from twin.robot.assembly.assemble import Assembly, assemble
from twin.robot.experiment.experiment import Experiment
from twin.robot.run.watch import run_observers


class BranchPoint:
    """The tick of a run at which its branches begin, with the state there; `recording` may contain states.

    Attributes:
        lacking: per component without a state, the reason.
        how: description of the origin: a saved state, or a run from the start.
    """

    def __init__(self, experiment: Experiment, recording: Path, tick: int):
        self._experiment, self._recording, self._tick = experiment, recording, tick
        nearest = stored_state(recording, tick * experiment.cosim.tick)
        with assemble(experiment) as assembly:
            self.lacking = stateless_reasons(assembly.system.components)
            self._saved = None if self.lacking else self._state_at_tick(assembly, nearest)
        known = nearest if self._saved else None
        self.how = f"from the state at {known.time:g} s" if known else "run again from the start"

    @property
    def branch_state(self) -> StoredState:
        """State of the parent run at the tick where its branches begin."""
        if self._saved is None:
            raise InputRefused(f"{self._recording}: this run has no state: {'; '.join(self.lacking)}")
        return self._pack_state(self._saved)

    @contextmanager
    def hand_over(self, branched: Experiment) -> Iterator[StoredState]:
        """Yield the start state of one branch; live components in it are freed when the block ends."""
        for role in {**self._experiment.stand_ins, **branched.stand_ins}:
            if self._experiment.stand_ins.get(role) != branched.stand_ins.get(role):
                raise InputRefused(
                    f"{role} cannot change in mid-run: the state of a third-party part fits no other part"
                )
        if self._saved is not None:
            yield self.branch_state
            return
        with assemble(self._experiment) as assembly:
            alive = [component for component in assembly.system.components if component.lacks_state()]
            for component in alive:
                component.alive = True
            yield self._pack_state(self._state_at_tick(assembly), alive)

    def _state_at_tick(self, assembly: Assembly, nearest: StoredState | None = None) -> SavedState:
        """Simulate the parent run from the state `nearest`, or the start, to the branch tick; return its state."""
        experiment = self._experiment
        lasting: dict[str, Observer] = run_observers(experiment, assembly)._asdict() | {"recorder": EventLog()}
        observers = [*lasting.values(), _TickStop(self._tick)]
        before = nearest.saved_state if nearest else None
        done = simulate(assembly, experiment.duration_ticks, observers, state=before, lasting=lasting).require_success()
        state = done.simulation.state()
        saved = state.saved(observers={name: observer.state() for name, observer in lasting.items()})
        state.close()
        return saved

    def _pack_state(self, saved: SavedState, alive: list[Component] = []) -> StoredState:  # noqa: B006, it is only read
        time = self._tick * self._experiment.cosim.tick
        named = {component.name: component for component in alive}
        return StoredState(self._recording, time, saved.to_bytes(), branch=True, alive=named)


class _TickStop(Observer):
    """Observer that stops a simulation at the beginning of a tick."""

    def __init__(self, tick: int):
        self.halts = [tick]
        self._tick = tick

    def begin(self, simulation: Simulation) -> None:
        self._simulation = simulation
        self.enough = simulation.next_tick >= self._tick

    def on_rows(self, first: int, rows: Any, events: Any) -> None:
        self.enough = self._simulation.next_tick >= self._tick
