"""What isolation costs: a supervised process for the run, and one for each drive besides."""

import json
import subprocess
import sys
import tempfile
import time
from functools import partial
from pathlib import Path

from benchmarks.measurement import Measurement, Rounds
from twin.kernel.cosim.component import Component
from twin.kernel.cosim.observers import simulate
from twin.kernel.process.job import JobLimits
from twin.kernel.process.reporter import DirectReporter
from twin.robot.assembly.assemble import assemble
from twin.robot.assembly.drives import DrivePlan, Start, drive
from twin.robot.assembly.isolated_drive import IsolatedDrives
from twin.robot.assembly.load import load_experiment
from twin.robot.experiment.experiment import Experiment
from twin.robot.run.run import SLICE_TICKS

ROUNDS = 9
VOICE = DirectReporter(lambda note: None, lambda done, total: None)


def measurements(path: Path) -> list[Measurement]:
    """The lines of the table for the experiment at `path`."""
    experiment = load_experiment(path)
    with tempfile.TemporaryDirectory() as scratch:
        commands = Commands(path, Path(scratch))
        commands.seconds("run")
        whole = Rounds({name: partial(commands.seconds, name) for name in ("none", "run", "drive")}, ROUNDS)
    stepping = {name: sorted(commands.stepping[name][-ROUNDS:])[ROUNDS // 2] for name in ("none", "run")}
    drives = Rounds({str(count): partial(stepped, experiment, count) for count in (0, 1, 3)}, ROUNDS)
    ticks = experiment.duration_ticks
    per_tick = {count: 1e6 * (drives.typical(str(count)) - drives.typical("0")) / ticks for count in (1, 3)}
    return [
        Measurement("isolation: Fig. 4 stepping, none", 1e3 * stepping["none"], "ms"),
        Measurement("isolation: run adds to it", 1e3 * (stepping["run"] - stepping["none"]), "ms", at_most=20.0),
        Measurement(
            "isolation: run adds to the command", whole.typical("run") - whole.typical("none"), "s", at_most=0.6
        ),
        Measurement("isolation: twin run Fig. 4", whole.typical("run"), "s", at_most=3.1),
        Measurement("isolation: twin run Fig. 4 --isolate drive", whole.typical("drive"), "s"),
        Measurement("isolation: one drive, per step", per_tick[1], "us", at_most=15.0),
        Measurement("isolation: three drives, per step", per_tick[3], "us", at_most=50.0),
    ]


class Commands:
    """`twin run` with each kind of isolation.

    Attributes:
        stepping: by isolation, what the runs said they spent in the master (s).
    """

    def __init__(self, experiment: Path, scratch: Path):
        self._experiment, self._scratch = experiment, scratch
        self._count = 0
        self.stepping: dict[str, list[float]] = {"none": [], "run": [], "drive": []}

    def seconds(self, isolation: str) -> float:
        """Wall seconds of the whole command."""
        self._count += 1
        out = self._scratch / str(self._count)
        command = ["run", str(self._experiment), "--isolate", isolation, "--out", str(out), "--json"]
        began = time.perf_counter()
        done = subprocess.run([sys.executable, "-m", "twin", *command], capture_output=True, check=True)
        seconds = time.perf_counter() - began
        self.stepping[isolation].append(json.loads(done.stdout)["stepping_s"])
        return seconds


class FirstElsewhere:
    """Makes the first `count` drives in processes of their own."""

    one_process = True

    def __init__(self, drives: IsolatedDrives, count: int):
        self._drives, self._count = drives, count

    def drive(self, name: str, plan: DrivePlan, tick: float, theta_m: Start, tau_load: Start) -> Component:
        """See `twin.robot.assembly.drives.drive`."""
        elsewhere = int(name.removeprefix("drive_")) <= self._count
        return (self._drives.drive if elsewhere else drive)(name, plan, tick, theta_m, tau_load)


def stepped(experiment: Experiment, isolated: int) -> float:
    """Wall seconds of stepping `experiment` with the first `isolated` drives in processes of their own."""
    with (
        IsolatedDrives(VOICE, JobLimits.step, count=isolated) as drives,
        assemble(experiment, maker=FirstElsewhere(drives, isolated)) as assembly,
    ):
        return simulate(assembly, experiment.duration_ticks, (), SLICE_TICKS).require_success().stepping
