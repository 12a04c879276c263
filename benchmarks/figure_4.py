"""The whole Fig. 4 experiment: stepping alone, by component, and with recording."""

import tempfile
import time
from pathlib import Path
from statistics import median

from benchmarks.measurement import Measurement
from twin.assembly.assemble import assemble
from twin.assembly.load import load_experiment
from twin.cosim.simulation import Simulation
from twin.execution import SLICE_TICKS, execute
from twin.experiment.experiment import Experiment

ROUNDS = 7


def stepped(experiment: Experiment, timed: bool) -> tuple[float, dict[str, float]]:
    """Wall seconds of stepping `experiment`, nothing recorded; microseconds per tick by component if `timed`."""
    with assemble(experiment) as assembly:
        simulation = Simulation(assembly.system, experiment.duration_ticks, SLICE_TICKS, timed)
        began = time.perf_counter()
        while not simulation.finished:
            simulation.advance()
        seconds = time.perf_counter() - began
        if simulation.failure:
            raise simulation.failure
        shares = simulation.cycles / max(1, simulation.cycles.sum())
        per_tick = 1e6 * seconds / (experiment.duration_ticks + 1)
        names = [component.name for component in assembly.system.components]
        return seconds, dict(zip(names, (per_tick * shares).tolist(), strict=False))


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
