"""What it costs to run the robot as a system of exported FMUs."""

import tempfile
from pathlib import Path

from benchmarks.figure_4 import stepped
from benchmarks.measurement import Measurement, Rounds
from twin.kernel.cosim.observers import simulate
from twin.kernel.errors import InputRefused
from twin.kernel.ssp.package import read_package
from twin.kernel.systems.opening import open_system
from twin.robot.assembly.load import load_experiment
from twin.robot.run.run import SLICE_TICKS
from twin.studies.build.system import build_ssp

ROUNDS = 15
TITLE = "Fig. 4 as an SSP: stepping / the twin's own"


def seconds(file: Path) -> float:
    """Wall seconds of stepping the system of an SSP archive, nothing recorded."""
    with open_system(read_package(file)) as (plan, made):
        return simulate(made, plan.timing.ticks, (), SLICE_TICKS).require_success().stepping


def measurements(path: Path) -> list[Measurement]:
    """The line of the table for the experiment at `path`."""
    experiment = load_experiment(path)
    with tempfile.TemporaryDirectory() as scratch:
        file = Path(scratch) / "fig4.ssp"
        try:
            build_ssp(path, "2.0", (), file, None, (), lambda what: None)
        except InputRefused as problem:
            return [Measurement(TITLE, None, "x", at_most=1.3, remark=str(problem))]
        rounds = Rounds({"system": lambda: seconds(file), "own": lambda: stepped(experiment, timed=False)[0]}, ROUNDS)
    return [Measurement(TITLE, rounds.ratio("system", "own"), "x", at_most=1.3)]
