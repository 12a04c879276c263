"""Branches of a run: its state at one time, gone on with in an experiment that differs from then on.

Every component goes on from the state of the one with its name. A fault that was not there stands as if it had been
there from the start without acting: its clock is at the present tick, and what it passes on is what it is given.
"""

from collections.abc import Collection, Sequence
from pathlib import Path

from twin.kernel.cosim.simulation import Simulation
from twin.kernel.cosim.state import SavedState
from twin.kernel.errors import InputRefused
from twin.kernel.recording.reader import read_metadata
from twin.robot.assembly.load import recorded_experiment
from twin.robot.experiment.experiment import Experiment
from twin.robot.faults import FaultComponent

FIXED_KEYS = {
    "cosim": "steps and scheme hold for the whole run",
    "controller.period_ms": "calls of the controller are counted from the start",
    "drive": "what a drive holds inside fits no other one; run the experiment again with it",
    "duration_s": "FMUs know when the run ends",
    "seed": "random numbers were drawn before",
    "recording": "it belongs to the whole run",
    "robot": "it fills truth and belief before the start; set plant.* or controller.model.*",
}
"""Keys that cannot be other ones in mid-run, and why; all below them, too."""
LENGTH_KEYS = ("a_mm", "b_mm", "l_a_mm", "l_b_mm")
"""Of the mechanism, in any table: a rod that is suddenly longer is nowhere."""


def refuse_fixed_keys(settings: Sequence[str], option: str = "--set") -> None:
    """Refuse settings that cannot act from the middle of a run on.

    Args:
        settings: "table.key=value" texts.
        option: that they were given with.

    Raises:
        InputRefused: it names the key and says why.
    """
    for setting in settings:
        key = setting.partition("=")[0].strip()
        for fixed, why in FIXED_KEYS.items():
            if key == fixed or key.startswith(f"{fixed}."):
                raise InputRefused(f"{option} {setting}: {fixed} cannot change in mid-run: {why}")
        if key.rpartition(".")[2] in LENGTH_KEYS:
            raise InputRefused(f"{option} {setting}: lengths of the mechanism cannot change in mid-run")


def branched_experiment(
    recording: Path,
    settings: Sequence[str] = (),
    faults: Sequence[str] = (),
    body: str | None = None,
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
    refuse_fixed_keys(settings)
    return recorded_experiment(
        read_metadata(recording), recording, changed=True, settings=settings, faults=faults, body=body
    )


def start_branch(simulation: Simulation, saved: SavedState) -> None:
    """Let `simulation` of a branch go on from `saved`, the state of the run that it branches from.

    Raises:
        InputRefused: a component that was not there needs a past.
    """
    add_components(simulation, simulation.adopt(saved))


def add_components(simulation: Simulation, new: Collection[str]) -> None:
    """Let the components with the names `new` come into `simulation`, where all others are in mid-run.

    Raises:
        InputRefused: one of them needs a past.
    """
    for component in simulation.system.components:
        if component.name not in new:
            continue
        if isinstance(component, FaultComponent):
            component.join_run(simulation.next_tick)
            simulation.derive_outputs(component, component.idle_outputs)
        elif component.pieces() or component.holders():
            raise InputRefused(f"{component.name}: was not there before, and cannot begin in mid-run")
