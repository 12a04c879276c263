"""Many checks, one after the other, as a job of a process that may die of a drive."""

from collections.abc import Sequence
from dataclasses import asdict, dataclass, replace
from pathlib import Path
from typing import Any

from pydantic import TypeAdapter

from twin.errors import InputRefused, TwinError
from twin.experiment.drive_files import shelved
from twin.experiment.named import experiment_file
from twin.experiment.source import located
from twin.studies.check.baseline import OWN, Entry, baseline_of, baseline_text, known_baseline, stored_drives
from twin.studies.check.check import measured_with, stored_baseline
from twin.studies.check.verdict import CheckVerdict, verdict

ALL = "all"
"""Called like a drive: every drive of fmus/."""


@dataclass(frozen=True)
class Pair:
    """What is checked: an experiment's file with a drive."""

    file: str
    drive: str


@dataclass(frozen=True)
class CheckOutcome:
    """What a check came to.

    Attributes:
        verdict: None if it could not be measured or compared.
        text: of the baseline's file as it would be after an update; "" if that changes nothing, or nobody asked.
        failure: why there is no verdict, in a sentence; "" if there is one.
        exit_code: that goes with it.
    """

    pair: Pair
    verdict: CheckVerdict | None
    text: str = ""
    failure: str = ""
    exit_code: int = 0

    @classmethod
    def of(cls, note: dict[str, Any]) -> "CheckOutcome":
        """Put together again what `checked` has taken apart."""
        return TypeAdapter(cls).validate_python(note)


def pairs(experiments: Sequence[Path], drives: Sequence[str], folder: Path) -> list[Pair]:
    """What `twin check EXPERIMENT... --drive ...` means.

    Args:
        experiments: files or names; none: all that have a baseline in `folder`.
        drives: as --drive has them; none: those with a baseline, or the experiment's own.

    Raises:
        InputRefused: nothing to check, or a drive that none of the experiments finds.
    """
    files = [experiment_file(experiment) for experiment in experiments]
    if not experiments:
        # one that has gone is told of when its turn comes, and costs the others nothing
        stored = [one.name for one in sorted(folder.glob("*")) if one.is_dir()]
        files = [located(f"experiments/{name}.toml", Path.cwd()) for name in stored]
    if not files:
        raise InputRefused(
            f"{folder}: no baselines there; say which experiment: twin check EXPERIMENT --update --reason TEXT, or "
            "where they are: --baselines DIR"
        )
    shelf = [fmu.stem for fmu in sorted(located("fmus", Path.cwd()).glob("*/*.fmu"))]
    named = [name for drive in drives for name in (shelf if drive == ALL else [drive])]
    for name in named:
        if name != OWN and not any(Path(shelved(name, file.resolve().parent)).exists() for file in files):
            raise InputRefused(f"--drive {name}: no such drive; expected an .fmu file, a folder of fmus/, own or all")
    return [
        Pair(str(file), drive)
        for file in dict.fromkeys(files)
        # without a baseline the one that is missing is told of
        for drive in dict.fromkeys(named or stored_drives(folder, file.stem) or [OWN])
    ]


def checked(reporter: Any, work: Sequence[Pair], folder: Path, date: str, reason: str) -> None:
    """Check each pair of `work`; a job of the guard. Notes: an `CheckOutcome`, taken apart, per pair, in their order.

    Args:
        work: what to check.
        folder: of the baselines.
        date: of an update.
        reason: of an update; "": nobody asked for one.
    """
    for pair in work:
        reporter.loading()
        try:
            outcome = _outcome(pair, folder, date, reason)
        except TwinError as error:
            outcome = CheckOutcome(pair, None, failure=str(error), exit_code=error.exit_code)
        reporter.note(**asdict(outcome))


def _outcome(pair: Pair, folder: Path, date: str, reason: str) -> CheckOutcome:
    file = Path(pair.file)
    if not reason:
        before = stored_baseline(folder, file, pair.drive)
        experiment, now = measured_with(file, pair.drive)
        return CheckOutcome(pair, verdict(experiment, pair.drive, before, now))
    known = known_baseline(folder, file.stem, pair.drive)
    experiment, now = measured_with(file, pair.drive)
    history = known.history if known else ()
    after = baseline_of(experiment, pair.drive, now, (*history, Entry(date, reason)), known)
    same = known is not None and baseline_text(known) == baseline_text(replace(after, history=history))
    return CheckOutcome(pair, verdict(experiment, pair.drive, known, now), "" if same else baseline_text(after))
