"""The state of a run at one tick for its branches, and what no state can hold: FMUs without one, and other drives.

These are handed over to a branch as they are, alive, and for that the past is run again, for each branch anew. Drives
that are other ones in a branch run along in the past from the start: on the wires of those whose place they take,
feeding nothing. So at the branch they hold inside what the commands and loads of the past leave in them. Where a shaft
counts from is arbitrary, so the past is run twice: the second time the new drives start so that their shafts stand at
the branch where the old ones do. What jumps is the speed, by what two drives differ in following the same command.
"""

from collections.abc import Iterator
from contextlib import ExitStack, contextmanager
from dataclasses import replace
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np

from twin.kernel.cosim.component import Component
from twin.kernel.cosim.observers import Observer, simulate
from twin.kernel.cosim.port import by_port
from twin.kernel.cosim.simulation import Simulation
from twin.kernel.cosim.state import SavedState, stateless
from twin.kernel.errors import InputRefused
from twin.kernel.process.states import StoredState, stored_state
from twin.kernel.recording.recorder import EventLog
from twin.robot.assembly.assemble import HERE, Assembly, assemble, joined
from twin.robot.assembly.build import JOINTS, Build, DriveMaker, at_rest, joint_drives, planned_drives
from twin.robot.experiment.experiment import Experiment
from twin.robot.run.watch import run_observers

ALONG = "new_"
"""What the name of a drive begins with as long as it runs along."""
ANGLE_TOLERANCE = 1e-9
"""How far (rad) a shaft may jump: rounding of angles of some 1000 rad, and nothing more."""


class Handed(NamedTuple):
    """What a branch goes on from.

    Attributes:
        state: with what is alive.
        jump: of the speed of a shaft, at most (rad/s), where other drives take over; None: they are the same.
    """

    state: StoredState
    jump: float | None = None


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
            self.lacking = stateless(assembly.system.components)
            self._saved = None if self.lacking else self._come(assembly, nearest)[1]
        known = nearest if self._saved else None
        self.how = f"from the state at {known.time:g} s" if known else "run again from the start"

    @property
    def saved(self) -> StoredState:
        """The state.

        Raises:
            InputRefused: a component has none.
        """
        if self._saved is None:
            raise InputRefused(f"{self._recording}: this run has no state: {'; '.join(self.lacking)}")
        return self._stored(self._saved)

    @contextmanager
    def handed_over(self, branched: Experiment) -> Iterator[Handed]:
        """What one branch goes on from; what is alive in it ends with the block.

        Args:
            branched: what the branch runs.

        Raises:
            InputRefused: its drives cannot take over, or a third-party part is another one.
            ComponentFailed: a component failed on the way.
        """
        for role in {**self._experiment.stand_ins, **branched.stand_ins}:
            if self._experiment.stand_ins.get(role) != branched.stand_ins.get(role):
                raise InputRefused(f"{role} cannot change in mid-run: what a third-party part holds fits no other one")
        if _drives(self._experiment) != _drives(branched):
            with ExitStack() as stack:
                yield self._with_new_drives(stack, branched)
        elif self._saved is None:
            with assemble(self._experiment) as assembly:
                alive = [component for component in assembly.system.components if component.lacks_state()]
                for component in alive:
                    component.alive = True
                _, saved = self._come(assembly)
                yield Handed(self._stored(saved, alive))
        else:
            yield Handed(self.saved)

    def _with_new_drives(self, stack: ExitStack, branched: Experiment) -> Handed:
        shift = np.zeros(JOINTS)
        for _ in range(2):
            assembly = stack.enter_context(assemble(self._experiment))
            old = assembly.made["drive"]
            assembly, new = _run_along(stack, self._experiment, assembly, branched, shift)
            alive = [c for c in assembly.system.components if c in new or (c.lacks_state() and c not in old)]
            for component in (*alive, *old):
                component.alive = True
            simulation, saved = self._come(assembly)
            apart = _values(simulation, old, "theta_m") - _values(simulation, new, "theta_m")
            shift += apart
        if np.abs(apart).max() > ANGLE_TOLERANCE:
            raise InputRefused(
                f"{new[0].label}: its shaft cannot take over where that of {old[0].label} stands: started elsewhere it "
                f"comes {np.abs(apart).max():.2g} rad away from there; run the experiment again with it"
            )
        jump = float(np.abs(_values(simulation, old, "omega_m") - _values(simulation, new, "omega_m")).max())
        gone = {component.name for component in old}
        names = {component.name: component.name.removeprefix(ALONG) for component in new}
        for component in new:
            component.name = names[component.name]
        pieces = [
            piece._replace(component=names.get(piece.component, piece.component))
            for piece in saved.pieces
            if piece.component not in gone
        ]
        return Handed(self._stored(replace(saved, pieces=pieces), alive), jump)

    def _come(self, assembly: Assembly, nearest: StoredState | None = None) -> tuple[Simulation, SavedState]:
        """The run in `assembly` at the tick, from the state `nearest` or the start, and its state there."""
        experiment = self._experiment
        lasting: dict[str, Observer] = run_observers(experiment, assembly)._asdict() | {"recorder": EventLog()}
        observers = [*lasting.values(), _Until(self._tick)]
        before = nearest.saved if nearest else None
        done = simulate(assembly, experiment.duration_ticks, observers, state=before, lasting=lasting).completed()
        state = done.simulation.state()
        saved = state.saved(observers={name: observer.state() for name, observer in lasting.items()})
        state.close()
        return done.simulation, saved

    def _stored(self, saved: SavedState, alive: list[Component] = []) -> StoredState:  # noqa: B006, it is only read
        time = self._tick * self._experiment.cosim.tick
        named = {component.name: component for component in alive}
        return StoredState(self._recording, time, saved.to_bytes(), branch=True, alive=named)


class _Until(Observer):
    """Ends a simulation at the beginning of a tick."""

    def __init__(self, tick: int):
        self.halts = [tick]
        self._tick = tick

    def begin(self, simulation: Simulation) -> None:
        self._simulation = simulation
        self.enough = simulation.next_tick >= self._tick

    def take(self, first: int, rows: Any, events: Any) -> None:
        self.enough = self._simulation.next_tick >= self._tick


def _drives(experiment: Experiment) -> list[Any]:
    """What its drives are, whichever of them pin their file."""
    return [table.model_copy(update={"sha256": None}) for table in experiment.drives]


def _run_along(
    stack: ExitStack, experiment: Experiment, assembly: Assembly, branched: Experiment, shift: np.ndarray
) -> tuple[Assembly, list[Component]]:
    """`assembly` with the drives of `branched` beside its own, and these new drives.

    Args:
        stack: frees the new drives.
        experiment: of `assembly`.
        shift: added to the angles (3,), rad, at which the shafts start.
    """
    plans = planned_drives(branched)
    if branched.monitor is not None:
        plans = tuple(plan.switchable() for plan in plans)
    maker: DriveMaker = HERE
    if any(fmu.lives_once for plan in plans for fmu in plan.parts.values()):
        from twin.robot.assembly.isolated_drive import IsolatedDrives

        maker = stack.enter_context(IsolatedDrives(keep=True))
    plant, theta_m = at_rest(experiment)
    new = []
    for make in joint_drives(Build(experiment, plans, maker, plant, theta_m + shift)).values():
        new.append(make())
        stack.callback(new[-1].close)
        new[-1].name = ALONG + new[-1].name
    return replace(assembly, system=joined(experiment, assembly.made, new)), new


def _values(simulation: Simulation, drives: list[Component], port: str) -> np.ndarray:
    """What is valid of the output `port` of the three joints, (3,)."""
    return np.concatenate([by_port(drive.outputs, simulation.outputs(drive))[port] for drive in drives])
