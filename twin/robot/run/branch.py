"""Branches of a run: simulations that continue its state at one time with a changed experiment.

Each component continues from the state of the component with its name. A new fault is added as if it had been
present and idle from the start: its clock is at the current tick and its outputs equal its inputs.
"""

from collections.abc import Collection, Sequence
from pathlib import Path

from twin.kernel.cosim.simulation import Simulation
from twin.kernel.cosim.state import SavedState
from twin.kernel.errors import InputRefused
from twin.kernel.recording.reader import read_metadata
from twin.robot.assembly.load import recorded_experiment
from twin.robot.experiment.experiment import Experiment
from twin.robot.experiment.mistakes import LENGTH_KEYS
from twin.robot.faults import FaultComponent

FIXED_KEYS = {
    "cosim": "steps and scheme hold for the whole run",
    "controller.period_ms": "calls of the controller are counted from the start",
    "drive": "a drive's internal state fits no other drive; run the experiment again with it",
    "duration_s": "FMUs know when the run ends",
    "seed": "random numbers were drawn before",
    "recording": "it belongs to the whole run",
    "robot": "it fills truth and belief before the start; set plant.* or controller.model.*",
}
"""Keys that cannot change in mid-run, with the reasons; the keys below them neither."""


def refuse_fixed_keys(settings: Sequence[str], option: str = "--set") -> None:
    """Refuse settings of a branch, "table.key=value" texts of a command-line option, that cannot change in mid-run."""
    for setting in settings:
        key = setting.partition("=")[0].strip()
        for fixed, why in FIXED_KEYS.items():
            if key == fixed or key.startswith(f"{fixed}."):
                raise InputRefused(f"{option} {setting}: {fixed} cannot change in mid-run: {why}")
        # in every table: a rod whose length jumps has no consistent position
        if key.rpartition(".")[2] in LENGTH_KEYS:
            raise InputRefused(f"{option} {setting}: lengths of the mechanism cannot change in mid-run")


def branched_experiment(
    recording: Path,
    settings: Sequence[str] = (),
    faults: Sequence[str] = (),
    body: str | None = None,
) -> Experiment:
    """Load the experiment of a recorded run with changes that act from a later time on, see `recorded_experiment`."""
    refuse_fixed_keys(settings)
    return recorded_experiment(
        read_metadata(recording), recording, changed=True, settings=settings, faults=faults, body=body
    )


def start_branch(simulation: Simulation, saved: SavedState) -> None:
    """Start the simulation of a branch from the saved state of its parent run."""
    add_components(simulation, simulation.adopt(saved))


def add_components(simulation: Simulation, new: Collection[str]) -> None:
    """Start new components, such as faults, in a simulation where all others are in mid-run."""
    for component in simulation.system.components:
        if component.name not in new:
            continue
        if isinstance(component, FaultComponent):
            component.join_run(simulation.next_tick)
            simulation.derive_outputs(component, component.idle_outputs)
        elif component.pieces() or component.holders():
            raise InputRefused(f"{component.name}: was not there before, and cannot begin in mid-run")
