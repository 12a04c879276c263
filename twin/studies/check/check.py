"""An experiment checked against its baselines, for programs and tests."""

import shlex
from dataclasses import dataclass
from pathlib import Path

from twin.errors import InputRefused
from twin.experiment.experiment import Experiment
from twin.experiment.named import experiment_file
from twin.places import HOME
from twin.runs.assembly.load import load_experiment
from twin.studies.check.baseline import (
    FOLDER,
    OWN,
    Baseline,
    baseline_file,
    baselines_of,
    known_baseline,
    stored_drives,
)
from twin.studies.check.measurement import Measured, measured
from twin.studies.check.signals import run_for_measures
from twin.studies.check.verdict import CheckRow, verdict


@dataclass(frozen=True)
class Deviation:
    """A number or curve that is not what it was; `str` says it in one sentence."""

    experiment: str
    drive: str
    row: CheckRow

    def __str__(self) -> str:
        row, at = self.row, "" if self.row.at is None else f" at {self.row.at:g} s"
        told = f"{self.experiment}, {self.drive}: {row.name} is {row.word}"
        if row.now is None or row.before is None:
            return told
        return f"{told}: {row.now:.6g} {row.unit}{at}, was {row.before:.6g} within {row.bound:g}"


def check(experiment: str | Path, drive: str | None = None, baselines: str | Path | None = None) -> list[Deviation]:
    """Run an experiment and hold it against what is stored; nothing is written.

    Args:
        experiment: its file or name, see `experiment_file`.
        drive: a drive of fmus/ or an FMU; "own": the experiment's; None: every drive that has a baseline.
        baselines: folder that `twin check --update` has written to; None: see `baselines_of`.

    Returns:
        What deviates; empty if all is as it was.

    Raises:
        InputRefused: no baseline, or it cannot be compared, or a measure that this run gives no meaning.
        ComponentFailed, SafetyTrip: the run did not come to its end.
    """
    file = experiment_file(experiment)
    folder = baselines_of(file, update=False) if baselines is None else Path(baselines)
    drives = [drive] if drive is not None else stored_drives(folder, file.stem)
    if not drives:
        raise InputRefused(_no_baseline(folder, file, OWN))
    found = []
    for name in drives:
        baseline = stored_baseline(folder, file, name)
        loaded, now = measured_with(file, name)
        found += [Deviation(loaded.name, name, row) for row in verdict(loaded, name, baseline, now).deviations]
    return found


def measured_with(file: Path, drive: str) -> tuple[Experiment, Measured]:
    """The experiment in `file` with `drive` as every joint's, and what it comes to; exceptions as `check`."""
    experiment = _loaded(file, drive)
    return experiment, measured(experiment, run_for_measures(experiment))


def stored_baseline(folder: Path, file: Path, drive: str) -> Baseline:
    """The baseline of the experiment in `file` with `drive`.

    Raises:
        InputRefused: there is none, and it says how one is made; or it is damaged, or of something else.
    """
    known = known_baseline(folder, file.stem, drive)
    if known is None:
        # whoever misspells experiment or drive is told of that
        _loaded(file, drive)
        raise InputRefused(_no_baseline(folder, file, drive))
    return known


def _loaded(file: Path, drive: str) -> Experiment:
    return load_experiment(file, drive=None if drive == OWN else drive)


def _no_baseline(folder: Path, file: Path, drive: str) -> str:
    # what comes with twin is not written to
    folder = FOLDER if folder == HOME / FOLDER else folder
    elsewhere = [] if folder == FOLDER else ["--baselines", str(folder)]
    accept = shlex.join(["twin", "check", str(file), "--drive", drive, *elsewhere, "--update"])
    return (
        f"{baseline_file(folder, file.stem, drive)}: no baseline of {file.stem}; accept what it comes to now: "
        f'{accept} --reason "first"'
    )
