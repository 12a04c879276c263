"""What a command line names is looked at before a study is loaded, which takes a second or two: slips are told at once.

Whatever is refused here the study would refuse, too, in the same sentence.
"""

import os
import sys
from collections.abc import Iterable, Sequence
from pathlib import Path


def look_at_experiments(
    experiments: Iterable[Path],
    settings: Sequence[str] | None = None,
    drives: Sequence[str | None] = (None,),
    body: str | None = None,
) -> None:
    """See whether each experiment can be loaded with each of `drives`; arguments as of `load_experiment`.

    Raises:
        InputRefused: it cannot.
    """
    from twin.runs.assembly.load import load_experiment

    for experiment in experiments:
        for drive in drives:
            load_experiment(experiment, settings or (), drive, body)


def look_at_files(experiments: Iterable[Path]) -> None:
    """See whether the files of experiments are there, and those that they extend; what they say is the study's.

    Raises:
        InputRefused: one is not, or is no TOML.
    """
    from twin.experiment.named import experiment_file
    from twin.experiment.source import read_source

    for experiment in experiments:
        read_source(experiment_file(experiment))


def look_at_logs(logs: Iterable[Path]) -> None:
    """See whether there is anything at each path of `logs`: recordings, bags, files of others.

    Raises:
        InputRefused: there is not.
    """
    from twin.files import open_regular
    from twin.recording.folder import recording_in

    for log in logs:
        # not Path.exists, which raises for a name that is too long
        if os.path.lexists(log):
            continue
        if log.suffix:
            open_regular(log, sys.maxsize)
        recording_in(log)
