"""Early checks of the files on a command line, before a study is loaded, because loading lasts a second or two.

The study itself refuses the same input with the same message. Each function receives the values of a study's arguments
by name: `experiment` or `experiments`, `drive` or `drives`, `settings`, `body`, `log` or `runs`.
"""

import os
import shlex
import sys
from collections.abc import Sequence
from pathlib import Path
from typing import Any

from twin.kernel.errors import InputRefused, terminal_text
from twin.studies.command import ArgumentValues


def load_experiments(asked: ArgumentValues) -> None:
    """Check that each experiment on the command line loads with each drive, the settings and the body.

    Raises:
        InputRefused: an experiment cannot be loaded.
    """
    from twin.robot.assembly.load import load_experiment

    for experiment in _argument_values(asked, "experiment"):
        for drive in _argument_values(asked, "drive") or (None,):
            for body in asked.get("bodies") or (asked.get("body"),):
                load_experiment(experiment, asked.get("settings") or (), drive, body)


def find_experiments(asked: ArgumentValues) -> None:
    """Check that the experiment files on the command line, and the files they extend, exist and are TOML.

    Raises:
        InputRefused: a file is missing or not TOML.
    """
    from twin.robot.experiment.experiment_files import experiment_file
    from twin.robot.experiment.source import read_source

    for experiment in _argument_values(asked, "experiment"):
        read_source(experiment_file(experiment))


def find_logs(asked: ArgumentValues) -> None:
    """Check that each log on the command line exists: recordings, bags, third-party files.

    Raises:
        InputRefused: a path is missing.
    """
    from twin.kernel.files import open_regular
    from twin.kernel.recording.folder import recording_in

    for log in _logs(asked):
        # not Path.exists, which raises for names that are too long
        if os.path.lexists(log):
            continue
        if log.suffix:
            open_regular(log, sys.maxsize)
        recording_in(log)


def print_latest(asked: ArgumentValues) -> dict[str, Any]:
    """Print to standard error which run is read as the latest, and its changed settings.

    Prints nothing about a file, a run's own folder, or a path that is not a folder of runs, which reading refuses.

    Returns:
        For `--json`: "read", the folder and the changed settings of each such run; empty if no path needs it.
    """
    from twin.kernel.recording.folder import recording_in

    found = []
    for path in _logs(asked):
        try:
            recording = recording_in(path)
        except InputRefused:
            continue
        if path.is_dir() and recording.parent != path:
            # loads in half a second
            from twin.studies.results.stored import stored_run

            run = stored_run(recording)
            changed = run.words[1:]
            made = f", made with {shlex.join(changed)}" if changed else ""
            print(terminal_text(f"{path}: the latest run, {run.folder.name}{made}"), file=sys.stderr)
            found.append({"run": str(path / run.folder.name), "changed": changed})
    return {"read": found} if found else {}


def _logs(asked: ArgumentValues) -> Sequence[Path]:
    # shadow names its logs as text among several sources
    return (
        _argument_values(asked, "log")
        or _argument_values(asked, "run")
        or [Path(text) for text in _argument_values(asked, "source")]
    )


def _argument_values(asked: ArgumentValues, name: str) -> Sequence:
    """Return the values of a command-line argument that is given singly or as a list."""
    one = asked.get(name)
    return asked.get(f"{name}s") or () if one is None else [one]
