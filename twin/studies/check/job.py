"""Many checks, one after the other, as a job of a process that may die of a drive."""

from collections.abc import Sequence
from dataclasses import asdict, dataclass
from pathlib import Path
from typing import Any

from pydantic import TypeAdapter

from twin.errors import InputRefused, TwinError
from twin.experiment.drive_files import shelved
from twin.experiment.named import experiment_file
from twin.places import located
from twin.studies.check.baseline import (
    FOLDER,
    OWN,
    Entry,
    baseline_of,
    baseline_text,
    baselines_here,
    baselines_of,
    known_baseline,
    stored_drives,
)
from twin.studies.check.check import measured_with, stored_baseline
from twin.studies.check.verdict import CheckVerdict, verdict

ALL = "all"
"""Called like a drive: every drive of fmus/."""


@dataclass(frozen=True)
class Pair:
    """What is checked: an experiment's file with a drive, against the baseline in a folder of such."""

    file: str
    drive: str
    folder: str


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


def pairs(
    experiments: Sequence[Path], drives: Sequence[str], baselines: Path | None, update: bool = False
) -> list[Pair]:
    """What `twin check EXPERIMENT... --drive ...` means.

    Args:
        experiments: files or names; none: all that have a baseline.
        drives: as --drive has them; none: those with a baseline, or the experiment's own.
        baselines: their folder; None: see `baselines_of`, and without experiments tests/baselines.
        update: see `baselines_of`.

    Raises:
        InputRefused: nothing to check, or a drive that none of the experiments finds.
    """
    files = [experiment_file(experiment) for experiment in experiments]
    if not experiments:
        baselines = baselines or (FOLDER if update else baselines_here())
        files = [_file_of(one.name) for one in sorted(baselines.glob("*")) if one.is_dir()]
    if not files:
        raise InputRefused(
            f"{baselines}: no baselines there; say which experiment: twin check EXPERIMENT --update --reason TEXT, or "
            "where they are: --baselines DIR"
        )
    shelf = [fmu.stem for fmu in sorted(located("fmus", Path.cwd()).glob("*/*.fmu"))]
    named = [name for drive in drives for name in (shelf if drive == ALL else [drive])]
    for name in named:
        if name != OWN and not any(Path(shelved(name, file.resolve().parent)).exists() for file in files):
            raise InputRefused(f"--drive {name}: no such drive; expected an .fmu file, a folder of fmus/, own or all")
    folders = {file: baselines or baselines_of(file, update) for file in files}
    return [
        Pair(str(file), drive, str(folder))
        for file, folder in folders.items()
        # without a baseline the one that is missing is told of
        for drive in dict.fromkeys(named or stored_drives(folder, file.stem) or [OWN])
    ]


def _file_of(name: str) -> Path:
    """The file of an experiment that has a baseline; one that has gone costs the others nothing, and is told of when
    its turn comes."""
    here = Path(f"{name}.toml")
    return here if here.is_file() else located(f"experiments/{name}.toml", Path.cwd())


def checked(reporter: Any, work: Sequence[Pair], date: str, reason: str) -> None:
    """Check each pair of `work`; a job of the guard. Notes: an `CheckOutcome`, taken apart, per pair, in their order.

    Args:
        work: what to check.
        date: of an update.
        reason: of an update; "": nobody asked for one.
    """
    for pair in work:
        reporter.loading()
        try:
            outcome = _outcome(pair, date, reason)
        except TwinError as error:
            outcome = CheckOutcome(pair, None, failure=str(error), exit_code=error.exit_code)
        reporter.note(**asdict(outcome))


def _outcome(pair: Pair, date: str, reason: str) -> CheckOutcome:
    file, folder = Path(pair.file), Path(pair.folder)
    if not reason:
        before = stored_baseline(folder, file, pair.drive)
        experiment, now = measured_with(file, pair.drive)
        return CheckOutcome(pair, verdict(experiment, pair.drive, before, now))
    known = known_baseline(folder, file.stem, pair.drive)
    experiment, now = measured_with(file, pair.drive)
    history = known.history if known else ()
    after = baseline_of(experiment, pair.drive, now, (*history, Entry(date=date, reason=reason)), known)
    same = known is not None and baseline_text(known) == baseline_text(after.model_copy(update={"history": history}))
    return CheckOutcome(pair, verdict(experiment, pair.drive, known, now), "" if same else baseline_text(after))
