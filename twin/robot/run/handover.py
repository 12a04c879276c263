"""The state of a run at one tick, for its branches; FMUs without a state are handed over alive.

For that the past is run again, for each branch anew.
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
    """The tick of a run at which branches leave it.

    Args:
        experiment: of the run, unchanged.
        recording: its file, which may have states.
        tick: within the run.

    Attributes:
        lacking: a sentence on each component without a state.
        how: where the run was gone on from to come there.

    Raises:
        InputRefused: a part of the run does not fit any more.
        ComponentFailed: a component failed on the way.
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
        """The state.

        Raises:
            InputRefused: a component has none.
        """
        if self._saved is None:
            raise InputRefused(f"{self._recording}: this run has no state: {'; '.join(self.lacking)}")
        return self._pack_state(self._saved)

    @contextmanager
    def hand_over(self, branched: Experiment) -> Iterator[StoredState]:
        """The state that one branch continues from; components alive in it end with the block.

        Args:
            branched: what the branch runs.

        Raises:
            InputRefused: a third-party part is another one.
            ComponentFailed: a component failed on the way.
        """
        for role in {**self._experiment.stand_ins, **branched.stand_ins}:
            if self._experiment.stand_ins.get(role) != branched.stand_ins.get(role):
                raise InputRefused(f"{role} cannot change in mid-run: what a third-party part holds fits no other one")
        if self._saved is not None:
            yield self.branch_state
            return
        with assemble(self._experiment) as assembly:
            alive = [component for component in assembly.system.components if component.lacks_state()]
            for component in alive:
                component.alive = True
            yield self._pack_state(self._state_at_tick(assembly), alive)

    def _state_at_tick(self, assembly: Assembly, nearest: StoredState | None = None) -> SavedState:
        """The state at the tick of the run in `assembly`, from the state `nearest` or the start."""
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
    """Ends a simulation at the beginning of a tick."""

    def __init__(self, tick: int):
        self.halts = [tick]
        self._tick = tick

    def begin(self, simulation: Simulation) -> None:
        self._simulation = simulation
        self.enough = simulation.next_tick >= self._tick

    def on_rows(self, first: int, rows: Any, events: Any) -> None:
        self.enough = self._simulation.next_tick >= self._tick
