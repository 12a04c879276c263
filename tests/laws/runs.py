"""Experiments of experiments/, co-simulated without recording, and sampled components evaluated by hand."""

from dataclasses import replace
from pathlib import Path

from twin.robot.assembly.build import plant_parameters
from twin.robot.assembly.load import load_experiment
from twin.robot.experiment.experiment import Experiment
from twin.robot.run.trace import Trace, run_in_memory
from twin.studies.converge.monolith import ComponentStepper

EXPERIMENTS = Path(__file__).resolve().parents[2] / "experiments"
FORCE, POSITION = "fig4_force_position", "fig4_position"
EVERY_EXPERIMENT = sorted(path.stem for path in EXPERIMENTS.glob("*.toml"))

__all__ = [
    "EVERY_EXPERIMENT", "EXACT_ENCODERS", "EXPERIMENTS", "FORCE", "PARAMETERS", "POSITION", "ComponentStepper",
    "co_simulated", "shipped",
]  # fmt: skip

EXACT_ENCODERS = tuple(
    f"{owner}.{encoder}_counts_per_turn={2**40}"
    for owner in ("plant", "controller.model")
    for encoder in ("motor", "joint")
)
"""Overrides that make a count 6e-12 rad."""


def shipped(name: str = FORCE, *overrides: str) -> Experiment:
    """An experiment of experiments/ with `overrides` as in `twin run --set`."""
    return load_experiment(EXPERIMENTS / f"{name}.toml", overrides)


PARAMETERS = plant_parameters(shipped().plant, shipped().contact)
"""The plant of the shipped experiment."""


def co_simulated(experiment: Experiment, duration: float = 20.0) -> Trace:
    """`experiment` with its real drive FMUs, from 0 to `duration` (s)."""
    return run_in_memory(replace(experiment, duration_ticks=round(duration / experiment.cosim.tick)))
