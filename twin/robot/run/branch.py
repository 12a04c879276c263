"""Branches of a run: its state at one time, gone on with in an experiment that differs from then on.

Every component goes on from the state of the one with its name. A fault that was not there stands as if it had been
there from the start without acting: its clock is at the present tick, and what it passes on is what it is given.
"""

from collections.abc import Collection, Sequence
from pathlib import Path
from typing import Any

from twin.kernel.cosim.observers import Observer, simulate
from twin.kernel.cosim.simulation import Simulation
from twin.kernel.cosim.state import SavedState, stateless
from twin.kernel.errors import InputRefused
from twin.kernel.process.states import StoredState, stored_state
from twin.kernel.recording.reader import origin
from twin.kernel.recording.recorder import EventLog
from twin.robot.assembly.assemble import assemble
from twin.robot.assembly.load import recorded_experiment
from twin.robot.experiment.experiment import Experiment
from twin.robot.faults import FaultComponent
from twin.robot.run.watch import run_observers

FIXED = {
    "cosim": "steps and scheme hold for the whole run",
    "controller.period_ms": "calls of the controller are counted from the start",
    "duration_s": "FMUs know when the run ends",
    "seed": "random numbers were drawn before",
    "recording": "it belongs to the whole run",
    "robot": "it fills truth and belief before the start; set plant.* or controller.model.*",
    "drive": "what a drive holds inside fits no other drive; run the experiment again with it",
}
"""Keys that cannot be other ones in mid-run, and why; all below them, too."""
LENGTHS = ("a_mm", "b_mm", "l_a_mm", "l_b_mm")
"""Of the mechanism, in any table: a rod that is suddenly longer is nowhere."""


def refuse_fixed(settings: Sequence[str]) -> None:
    """Refuse settings that cannot act from the middle of a run on.

    Raises:
        InputRefused: it names the key and says why.
    """
    for setting in settings:
        key = setting.partition("=")[0].strip()
        for fixed, why in FIXED.items():
            if key == fixed or key.startswith(f"{fixed}."):
                raise InputRefused(f"--set {setting}: {fixed} cannot change in mid-run: {why}")
        if key.rpartition(".")[2] in LENGTHS:
            raise InputRefused(f"--set {setting}: lengths of the mechanism cannot change in mid-run")


def branched_experiment(
    recording: Path, settings: Sequence[str] = (), faults: Sequence[str] = (), body: str | None = None
) -> Experiment:
    """The experiment of `recording` with changes that act from some time on.

    Args:
        recording: the file.
        settings: "table.key=value" texts.
        faults: inline tables of TOML, added to its own.
        body: a file of bodies/ in place of its own; its height stays.

    Raises:
        InputRefused: a setting cannot change in mid-run, or is none that an experiment may have.
    """
    refuse_fixed(settings)
    return recorded_experiment(origin(recording), recording, changed=True, settings=settings, faults=faults, body=body)


def state_at(experiment: Experiment, recording: Path, tick: int) -> tuple[StoredState, str]:
    """The state at the beginning of `tick`, and where it was gone on from to come there.

    Args:
        experiment: of the recording, unchanged.
        recording: the file, which may have states.
        tick: within the run.

    Raises:
        InputRefused: a component has no state.
        ComponentFailed: a component failed on the way.
    """
    nearest = stored_state(recording, tick * experiment.cosim.tick)
    with assemble(experiment) as assembly:
        if missing := stateless(assembly.system.components):
            raise InputRefused(f"{recording}: this run cannot be branched: {'; '.join(missing)}")
        before = nearest.saved if nearest else None
        lasting: dict[str, Observer] = run_observers(experiment, assembly)._asdict() | {"recorder": EventLog()}
        observers = [*lasting.values(), _Until(tick)]
        done = simulate(assembly, experiment.duration_ticks, observers, state=before, lasting=lasting)
        done.completed()
        state = done.simulation.state()
        saved = state.saved(observers={name: observer.state() for name, observer in lasting.items()})
        state.close()
    how = f"from the state at {nearest.time:g} s" if nearest else "run again from the start"
    return StoredState(recording, tick * experiment.cosim.tick, saved.to_bytes(), branch=True), how


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


def branch_off(simulation: Simulation, saved: SavedState) -> None:
    """Let `simulation` of a branch go on from `saved`, the state of the run that it branches from.

    Raises:
        InputRefused: a component that was not there needs a past.
    """
    bring_in(simulation, simulation.adopt(saved))


def bring_in(simulation: Simulation, new: Collection[str]) -> None:
    """Let the components with the names `new` come into `simulation`, where all others are in mid-run.

    Raises:
        InputRefused: one of them needs a past.
    """
    for component in simulation.system.components:
        if component.name not in new:
            continue
        if isinstance(component, FaultComponent):
            component.join(simulation.next_tick)
            simulation.join(component, component.passed_on)
        elif component.pieces() or component.holders():
            raise InputRefused(f"{component.name}: was not there before, and cannot begin in mid-run")
