"""The whole Fig. 4 experiment: stepping alone, by component, and with recording."""

import tempfile
from pathlib import Path
from statistics import median

from benchmarks.measurement import Measurement
from twin.kernel.cosim.observers import simulate
from twin.robot.assembly.assemble import assemble
from twin.robot.assembly.load import load_experiment
from twin.robot.experiment.experiment import Experiment
from twin.robot.run.run import SLICE_TICKS, execute

ROUNDS = 7


def stepped(experiment: Experiment, timed: bool) -> tuple[float, dict[str, float]]:
    """Wall seconds of stepping `experiment`, nothing recorded; microseconds per tick by component if `timed`."""
    with assemble(experiment) as assembly:
        done = simulate(assembly, experiment.duration_ticks, (), SLICE_TICKS, timed).require_success()
        return done.stepping, {name: 1e6 * cost for name, cost in done.costs.items()}


def measurements(path: Path) -> list[Measurement]:
    """The lines of the table for the experiment at `path`."""
    experiment = load_experiment(path)
    simulated = experiment.duration_ticks * experiment.cosim.tick
    bare, by_component, stepping, writing = [], [], [], []
    with tempfile.TemporaryDirectory() as scratch:
        for number in range(ROUNDS):
            bare.append(stepped(experiment, timed=False)[0])
            by_component.append(stepped(experiment, timed=True)[1])
            folder = Path(scratch) / str(number)
            folder.mkdir()
            run = execute(experiment, folder)
            stepping.append(run.stepping)
            writing.append(run.writing)
    ratios = [w / s for w, s in zip(writing, stepping, strict=True)]
    return [
        Measurement("Fig. 4: stepping, x real time", simulated / median(bare), "x", at_least=200.0),
        Measurement("Fig. 4: stepping, per tick", 1e6 * median(bare) / (experiment.duration_ticks + 1), "us"),
        *(
            Measurement(f"Fig. 4: of it {name}", median(turn[name] for turn in by_component), "us")
            for name in by_component[0]
        ),
        Measurement("Fig. 4: recording the run", median(writing), "s", at_most=1.0),
        Measurement("Fig. 4: recording / stepping", median(ratios), "x"),
    ]
