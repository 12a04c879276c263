"""One FMU of a survey: what it is and what came of trying it, as a row of data."""

from dataclasses import asdict
from pathlib import Path
from typing import Any

from twin.cache_folder import cache_folder
from twin.drive.unpacked import CONTENT, HOME
from twin.errors import InputRefused, TwinError, visible
from twin.experiment.drive_files import lone_drive
from twin.runs.assembly.drives import planned
from twin.runs.guard.guard import JobEnded, JobEndedLoading, guarded
from twin.runs.guard.limits import Limits
from twin.runs.guard.reporter import Reporter
from twin.studies.lines import counted
from twin.studies.reference.carried import carried
from twin.studies.reference.outcome import BAD, DEFAULT, Outcome, default_outcome, references
from twin.studies.survey.stated import stated

JOB = "twin.studies.survey.fmu:tried"
POINTER = b"version https://git-lfs"
LONGEST = 400
"""Characters of a sentence: what an FMU says in its own words may be long."""


def row(file: Path, digest: str, limits: Limits) -> dict[str, Any]:
    """What the FMU `file` is and what came of trying it, in a process that may crash or hang.

    Keys: file, sha256; model, tool, fmi, kinds, platforms as of `Stated`, where it can be read; drive, whether it fits
    the contract as it is; tried; word, one of `WORDS`; detail, one sentence.

    Raises:
        InputRefused: the disk refuses to read it.
    """
    known: dict[str, Any] = {"file": file.name, "sha256": digest, "drive": False, "tried": "nothing"}
    with file.open("rb") as stream:
        if stream.read(len(POINTER)) == POINTER:
            return known | {"word": "refused", "detail": "a Git LFS pointer stands in its place"}
    try:
        found = guarded(JOB, {"file": str(file)}, limits, known.update)
    except (JobEnded, JobEndedLoading) as failure:
        found = {"word": "lost", "detail": str(failure)}
    except TwinError as refusal:
        found = {"word": "refused", "detail": str(refusal)}
    known |= found
    return known | {"detail": _without_paths(known["detail"], file, digest)}


def tried(reporter: Reporter, file: str) -> dict[str, Any]:
    """What came of trying the FMU `file`; a job of the guard.

    Notes what it says of itself, then what is tried.

    Raises:
        InputRefused: it is no FMU.
    """
    path = Path(file)
    reporter.note(**asdict(stated(path)))
    try:
        planned(lone_drive(file, path.parent))
        reporter.note(drive=True)
    except InputRefused:
        pass
    came = len(carried(path).trials)
    reporter.note(tried=counted(came, "experiment") + " that came with it" if came else DEFAULT)
    found = references(path, apart=False)
    if not (came and found):
        return _told(default_outcome(path))
    order = (*BAD, "agrees", "ran")
    return _told(min(found.outcomes, key=lambda outcome: order.index(outcome.word)))


def _told(outcome: Outcome) -> dict[str, Any]:
    return {"word": outcome.word, "detail": outcome.detail}


def _without_paths(sentence: str, file: Path, digest: str) -> str:
    """A sentence on one line that tells nothing of this machine."""
    unpacked = cache_folder(HOME) / digest / CONTENT
    for place in (f"{unpacked}/", f"{unpacked}", f"{file.parent}/"):
        sentence = sentence.replace(place, "")
    sentence = visible(" ".join(sentence.split()))
    return sentence if len(sentence) <= LONGEST else sentence[: LONGEST - 3] + "..."
