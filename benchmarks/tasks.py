"""The massage tasks: how much faster than real time they step, and what safety monitor and a fault add to a tick."""

from pathlib import Path
from statistics import median

from benchmarks.figure_4 import stepped
from benchmarks.measurement import Measurement
from twin.robot.assembly.load import load_experiment

ROUNDS = 5
TASKS = ("pressing", "tapping", "rolling", "pushing")
SLOWEST = 150.0
"""Times real time that a task has to reach."""
FAULT = 'fault=[{kind="encoder_bias", onset_s=1.0, magnitude_deg=0.1}]'
UNWATCHED = "monitor.enabled=false"


def measurements(folder: Path) -> list[Measurement]:
    """The lines of the table for the experiments in `folder`."""
    found = []
    for task in TASKS:
        experiment = load_experiment(folder / f"{task}.toml")
        seconds = median(stepped(experiment, timed=False)[0] for _ in range(ROUNDS))
        simulated = experiment.duration_ticks * experiment.cosim.tick
        found.append(Measurement(f"{task}: stepping, x real time", simulated / seconds, "x", at_least=SLOWEST))
    plain, watched, faulty = (
        load_experiment(folder / "pressing.toml", settings) for settings in ([UNWATCHED], [], [UNWATCHED, FAULT])
    )
    rounds = [[stepped(one, timed=False)[0] for one in (plain, watched, faulty)] for _ in range(ROUNDS)]
    return [
        *found,
        Measurement("pressing: with safety monitor / without", median(w / p for p, w, _ in rounds), "x"),
        Measurement("pressing: with a fault / without", median(f / p for p, _, f in rounds), "x"),
    ]
