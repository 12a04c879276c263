"""What a live view costs: each published message, and a run that goes as fast as it can."""

import subprocess
import sys
import tempfile
import time
from collections.abc import Sequence
from functools import partial
from importlib.util import find_spec
from pathlib import Path
from statistics import median
from typing import NamedTuple

import numpy as np

from benchmarks.measurement import Measurement, Rounds
from twin.kernel.cosim.observers import TickEvent
from twin.kernel.recording.recorder import RowStream
from twin.robot.assembly.load import load_experiment
from twin.robot.experiment.experiment import Experiment
from twin.robot.run.run import execute
from twin.robot.run.tuning import Tuning
from twin.robot.run.viewer import Viewer
from twin.robot.scene import Scene

ROUNDS = 15
PACED_ROUNDS = 5
FACTOR = 20.0
"""Times real time, of the run in which messages are counted."""
NEEDED = "websockets"


def measurements(path: Path) -> list[Measurement]:
    """The lines of the table for the experiment at `path`."""
    experiment = load_experiment(path)
    message, delay = "live: a published message", "live: unpaced Fig. 4, watched / not"
    if find_spec(NEEDED) is None:
        remark = f"live view: {NEEDED} not installed"
        return [Measurement(name, None, "", remark=remark) for name in (message, delay)]
    rounds = Rounds({name: partial(unpaced, experiment, name == "live") for name in ("plain", "live")}, ROUNDS)
    costs = [_run(experiment, FACTOR, live=True) for _ in range(PACED_ROUNDS)]
    return [
        Measurement(message, 1e6 * median(cost.shown / cost.messages for cost in costs), "us", at_most=10.0),
        Measurement(delay, rounds.ratio("live", "plain"), "x", at_most=1.2),
    ]


class Stopwatch:
    """A viewer that hands everything on to `viewer`, if there is one.

    Attributes:
        began: when the run did (s). shown: time spent showing (s).
    """

    def __init__(self, viewer: Viewer | None = None):
        self._viewer = viewer
        self.began = self.shown = 0.0

    def begin(self, streams: Sequence[RowStream], scene: Scene, tick: float, tuning: Tuning) -> None:
        if self._viewer:
            self._viewer.begin(streams, scene, tick, tuning)
        self.began = time.perf_counter()

    def show(self, first: int, rows: np.ndarray, events: Sequence[TickEvent]) -> None:
        began = time.perf_counter()
        if self._viewer:
            self._viewer.show(first, rows, events)
        self.shown += time.perf_counter() - began


def unpaced(experiment: Experiment, live: bool) -> float:
    """Wall seconds of running and recording `experiment`, watched by a viewer of everything if `live`."""
    return _run(experiment, None, live).seconds


class Cost(NamedTuple):
    """Wall seconds from the first tick to the end of the recording; of it in the viewer; messages that it received."""

    seconds: float
    shown: float
    messages: int


def _run(experiment: Experiment, factor: float | None, live: bool) -> Cost:
    with tempfile.TemporaryDirectory() as scratch:
        if not live:
            watch = Stopwatch()
            execute(experiment, Path(scratch), factor=factor, viewer=watch)
            return Cost(time.perf_counter() - watch.began, 0.0, 0)
        from twin.robot.live.server import LiveServer

        clients: list[subprocess.Popen[str]] = []
        with LiveServer(0, lambda text: clients.append(_client(text.split()[1].rstrip(";")))) as server:
            watch = Stopwatch(server)
            execute(experiment, Path(scratch), factor=factor, viewer=watch)
            seconds = time.perf_counter() - watch.began
        return Cost(seconds, watch.shown, int(clients[0].communicate()[0]))


def _client(address: str) -> "subprocess.Popen[str]":
    command = [sys.executable, "-m", "benchmarks.live_viewer", address]
    return subprocess.Popen(command, stdout=subprocess.PIPE, text=True)
