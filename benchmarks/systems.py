"""What it costs to run the robot as a system of exported FMUs."""

import tempfile
from pathlib import Path

from benchmarks.figure_4 import stepped
from benchmarks.measurement import Measurement, Rounds
from tests.studies.build.system import fig4
from twin.errors import InputRefused
from twin.runs.assembly.load import load_experiment
from twin.runs.loop import simulate
from twin.runs.run import SLICE_TICKS
from twin.runs.trace import run_in_memory
from twin.ssp.package import read_package
from twin.studies.build.study import build_fmu
from twin.studies.systems.study import opened

ROUNDS = 15
TITLE = "Fig. 4 as an SSP: stepping / the twin's own"


def seconds(file: Path) -> float:
    """Wall seconds of stepping the system of an SSP archive, nothing recorded."""
    with opened(read_package(file)) as (plan, made):
        return simulate(made, plan.timing.ticks, (), SLICE_TICKS).completed().stepping


def measurements(path: Path) -> list[Measurement]:
    """The line of the table for the experiment at `path`."""
    experiment = load_experiment(path)
    droop = experiment.drives[0].parameters["droop"]
    start = run_in_memory(experiment, only=[f"drive/{leg}.theta_m" for leg in (1, 2, 3)]).of_drives("theta_m")[0]
    with tempfile.TemporaryDirectory() as scratch:

        def built(part: str) -> Path:
            file = Path(scratch) / f"{part}.fmu"
            if not file.exists():
                build_fmu(path, part, "2.0", file, (), lambda what: None)
            return file

        try:
            file = fig4(Path(scratch) / "fig4.ssp", built, float(str(droop)), start)
        except InputRefused as problem:
            return [Measurement(TITLE, None, "x", at_most=1.3, remark=str(problem))]
        rounds = Rounds({"system": lambda: seconds(file), "own": lambda: stepped(experiment, timed=False)[0]}, ROUNDS)
    return [Measurement(TITLE, rounds.ratio("system", "own"), "x", at_most=1.3)]
