"""What came of the experiments that came with an FMU; each is run in a process of its own, if that is asked for."""

from collections.abc import Callable, Sequence
from dataclasses import asdict, dataclass, field, replace
from pathlib import Path
from typing import Any

from twin.drive.description import FmuDescription, described
from twin.errors import InputRefused, TwinError
from twin.experiment.schema import Drive
from twin.runs.assembly.drives import planned
from twin.runs.guard.guard import JobEnded, JobEndedLoading, guarded
from twin.runs.guard.limits import JobLimits
from twin.runs.guard.reporter import Reporter
from twin.studies.answer import Answer
from twin.studies.lines import counted, labelled, wrapped
from twin.studies.reference.bare_run import TOLERANCE, BareRun, bare_run, deviations
from twin.studies.reference.carried import Carried, Prepared, Trial, carried, prepared
from twin.studies.reference.series import Series

DEFAULT = "default experiment"
JOB = "twin.studies.reference.outcome:tried"
WORDS = {
    "agrees": "it did what the results say",
    "differs": "it did something else than the results say",
    "ran": "it ran to the end; there are no results to hold it to",
    "refused": "something was refused before it ran",
    "failed": "it could not be initialised, or returned an error, NaN or infinity",
    "lost": "its process crashed, hung or outgrew its limits",
}
BAD = ("lost", "failed", "differs", "refused")
"""Worst first."""


@dataclass(frozen=True)
class Outcome:
    """Of an experiment.

    Attributes:
        experiment: its name.
        word: one of `WORDS`.
        detail: one sentence.
        deviations: by signal, in multiples of the tolerance.
    """

    experiment: str
    word: str
    detail: str
    deviations: dict[str, float] = field(default_factory=dict)


@dataclass(frozen=True)
class References:
    """What came with an FMU and what came of it."""

    file: Path
    carried: Carried
    outcomes: tuple[Outcome, ...]

    @property
    def holds(self) -> bool:
        """Whether nothing is against it."""
        return not any(outcome.word in BAD for outcome in self.outcomes)

    def facts(self) -> dict[str, Any]:
        """For JSON."""
        return {
            "file": self.file.name,
            "unread": dict(self.carried.unread),
            "experiments": [asdict(outcome) for outcome in self.outcomes],
            "tolerance": TOLERANCE,
        }


def references(file: Path, apart: bool, limits: JobLimits = JobLimits()) -> References | None:  # noqa: B008, it is frozen
    """What came with the FMU `file` and what comes of it; None if nothing did.

    Args:
        apart: each experiment in a process of its own, which costs that experiment only if it crashes.
        limits: of these processes.

    Raises:
        InputRefused: no sound archive, or its manifest is none.
    """
    found = carried(file)
    if not (found.unread or found.trials):
        return None
    run = _apart if apart else _here
    return References(file, found, tuple(run(file, n, trial, limits) for n, trial in enumerate(found.trials)))


def default_outcome(file: Path) -> Outcome:
    """What comes of the default experiment of an FMU, here."""
    return _here(file, 0, Trial(DEFAULT), JobLimits())


def tried(reporter: Reporter, file: str, number: int) -> dict[str, Any]:
    """Fields of the outcome of the trial `number` of the FMU `file`; a job of the guard."""
    trial = carried(Path(file)).trials[number]
    return asdict(_here(Path(file), number, trial, JobLimits(), lambda outcome: reporter.note(outcome=asdict(outcome))))


def _apart(file: Path, number: int, trial: Trial, limits: JobLimits) -> Outcome:
    noted: list[dict[str, Any]] = []
    try:
        # what can be refused without a process is
        _files(file, trial)
        return Outcome(**guarded(JOB, {"file": str(file), "number": number}, limits, noted.append))
    except (JobEnded, JobEndedLoading) as failure:
        # whether it can be freed is another question than whether it does what the results say
        if noted:
            outcome = Outcome(**noted[-1]["outcome"])
            return replace(outcome, detail=f"{outcome.detail}; then: {failure}")
        return Outcome(trial.name, "lost", str(failure))
    except InputRefused as refusal:
        return Outcome(trial.name, "refused", str(refusal))


def _here(
    file: Path, number: int, trial: Trial, limits: JobLimits, ended: Callable[[Outcome], None] = lambda outcome: None
) -> Outcome:
    name = trial.name
    outcomes: list[Outcome] = []

    def judge(run: BareRun) -> None:
        outcomes.append(_judged(name, run, files.results))
        ended(outcomes[-1])

    try:
        description, files = _files(file, trial)
        bare_run(description, trial, files, judge)
    except TwinError as trouble:
        word = "refused" if isinstance(trouble, InputRefused) else "failed"
        return Outcome(name, word, str(trouble))
    return outcomes[-1]


def _files(file: Path, trial: Trial) -> tuple[FmuDescription, Prepared]:
    description = described(file)
    return description, prepared(file, trial, description)


def _judged(name: str, run: BareRun, results: Series | None) -> Outcome:
    if not len(run.t):
        return Outcome(name, "failed", run.failure)
    how = f"{counted(len(run.t) - 1, 'step')} of {run.step:g} s"
    found = deviations(run, results) if results else []
    others = dict.fromkeys((*(results.others if results else ()), *run.unknown))
    if others:
        how += f"; not compared: {', '.join(others)}"
    if run.failure:
        # some end themselves, and so do their results then
        if results is None or not found or results.t[-1] > run.t[-1] + (1.0 + 1e-9) * run.step:
            return Outcome(name, "failed", run.failure)
        how += f"; then, as its results end: {run.failure}"
    if not found:
        return Outcome(name, "ran", how)
    shares = {one.signal: one.share for one in found}
    worst = max(found, key=lambda one: one.share)
    if worst.share <= 1.0:
        detail = f"{counted(len(shares), 'signal')}, at most {worst.share:.2g} of the tolerance off; {how}"
        return Outcome(name, "agrees", detail, shares)
    many = sum(share > 1.0 for share in shares.values())
    off = f"{worst.signal} by {worst.share:.3g} times the tolerance at {worst.t:g} s"
    return Outcome(name, "differs", f"{many} of {counted(len(shares), 'signal')} differ, {off}; {how}", shares)


def came_with(table: Drive, apart: bool) -> list[References]:
    """What came with each FMU of the drive that has something, run bare: its mapping and parameters are not for it.

    Args:
        apart: see `references`.

    Raises:
        InputRefused: no sound archive, a manifest that is none; an FMU that is not the one its mapping pins.
    """
    if table.sha256 or any(part.sha256 for part in table.parts.values()):
        # nothing of it is run before that
        planned(table)
    files = [Path(fmu) for fmu in (table.fmu, *(part.fmu for part in table.parts.values())) if fmu]
    return [found for file in files if (found := references(file, apart))]


def no_drive(came: Sequence[References], refusal: str) -> Answer:
    """The answer where the FMU is refused as a drive, after what came with it has been tried; `refused` says why."""
    facts = {"qualified": False, "refused": refusal, "references": [one.facts() for one in came]}
    return Answer(references_text(came), facts, 2)


def references_text(found: Sequence[References]) -> str:
    """What came with each FMU, then what came of it."""
    lines = []
    for one in found:
        lines += wrapped(f"came with {one.file.name}:")
        for name, why in one.carried.unread:
            lines += wrapped(f"{name}: {why}", "  --    not read   ", whole=True)
        for outcome in one.outcomes:
            verdict = "FAIL" if outcome.word in BAD else "ok"
            lines += wrapped(
                f"{outcome.experiment}: {outcome.detail}", f"  {verdict:4}  {outcome.word:10} ", whole=True
            )
    if any(outcome.deviations for one in found for outcome in one.outcomes):
        lines += labelled("note", f"tolerance: {TOLERANCE}")
    return "\n".join(lines)
