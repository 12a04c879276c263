"""What a user waits for before anything runs: whole processes, measured from outside."""

import json
import os
import subprocess
import sys
import tempfile
from collections.abc import Sequence
from functools import partial
from pathlib import Path
from statistics import median

from benchmarks.measurement import Measurement, Rounds

ROUNDS = 5
COLD_TURNS = 3
TURNS = 11
"""Of commands that take less than a tenth of a second."""
HELP = 12.0
"""Maximum time of `twin --help`, in times of a Python that does nothing."""
WATCH = Path(__file__).with_name("watch.py")
IMPORTS = "import twin.robot.run, twin.robot.assembly.load, twin.kernel.recording.folder"
MEGABYTE = 1024.0 if sys.platform != "darwin" else 1024.0**2
"""`ru_maxrss` counts kibibytes, on macOS bytes."""


def process(arguments: Sequence[str], **environment: str) -> tuple[float, float]:
    """Wall seconds and peak memory (MB) of one Python process with `arguments`.

    Raises:
        RuntimeError: it did not exit with 0.
    """
    command = [sys.executable, *arguments]
    watched = subprocess.run(
        [sys.executable, "-I", str(WATCH), *command],
        capture_output=True,
        env={**os.environ, **environment},
        check=True,
    )
    seen = json.loads(watched.stdout)
    if seen["exit"] != 0:
        raise RuntimeError(f"{' '.join(command)} exited with {seen['exit']}: {watched.stderr.decode().strip()}")
    return seen["seconds"], seen["maxrss"] / MEGABYTE


def measurements(experiment: Path) -> list[Measurement]:
    """The lines of the table; `experiment` is the one that `twin run` is given."""
    with tempfile.TemporaryDirectory() as scratch:
        runs = 0

        def run(**environment: str) -> tuple[float, float]:
            nonlocal runs
            runs += 1
            return process(["-m", "twin", "run", str(experiment), "--out", f"{scratch}/run_{runs}"], **environment)

        colds = [run(NUMBA_CACHE_DIR=f"{scratch}/cache_{turn}") for turn in range(COLD_TURNS)]
        cold, cold_peak = median(seconds for seconds, _ in colds), max(peak for _, peak in colds)
        run()  # whatever the last edit made stale is compiled here
        peaks = []

        def warm() -> float:
            seconds, peak = run()
            peaks.append(peak)
            return seconds

        rounds = Rounds(
            {
                "python": lambda: process(["-c", "pass"])[0],
                "numba": lambda: process(["-c", "import numba"])[0],
                "imports": lambda: process(["-c", IMPORTS])[0],
                "run": warm,
            },
            ROUNDS,
        )
    bare = rounds.typical("python")
    return [
        Measurement("start: bare Python", bare, "s"),
        help_measurement(),
        Measurement("start: what twin run imports", rounds.typical("imports") - bare, "s"),
        Measurement("start: twin run Fig. 4, warm", rounds.typical("run"), "s"),
        Measurement("start: that / import numba", rounds.ratio("run", "numba"), "x", at_most=2.5),
        Measurement("start: its peak memory", median(peaks), "MB", at_most=160.0),
        Measurement("start: compiling into an empty cache", cold - rounds.typical("run"), "s", at_most=6.0),
        Measurement("start: peak memory while compiling", cold_peak, "MB"),
    ]


def help_measurement() -> Measurement:
    """The command that only lists the others."""
    lines = {"python": ("-c", "pass"), "help": ("-m", "twin", "--help")}
    rounds = Rounds({name: partial(_seconds, *line) for name, line in lines.items()}, TURNS)
    return Measurement("start: twin --help / bare Python", rounds.ratio("help", "python"), "x", at_most=HELP)


def _seconds(*arguments: str) -> float:
    return process(arguments)[0]
