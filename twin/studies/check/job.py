"""Checks of experiments against their baselines, distributed over guarded processes."""

import shlex
import threading
from collections.abc import Callable, Sequence
from concurrent.futures import ThreadPoolExecutor
from dataclasses import asdict, dataclass
from datetime import date
from pathlib import Path
from typing import Any

from pydantic import TypeAdapter

from twin.kernel.errors import InputRefused, TwinError
from twin.kernel.process.guard import run_guarded
from twin.kernel.process.reporter import DirectReporter
from twin.robot.assembly.load import load_experiment
from twin.robot.experiment.drive_files import locate_drive
from twin.robot.experiment.experiment import Experiment
from twin.robot.experiment.experiment_files import experiment_file
from twin.robot.paths import PROJECT_FOLDER, locate_file
from twin.studies.check import baseline as stored
from twin.studies.check.measurement import Measurement, measure_signals, run_for_measures
from twin.studies.check.verdict import CheckRow, CheckVerdict, verdict
from twin.studies.command import Say

ALL_DRIVES = "all"
CHECK_JOB = "twin.studies.check.job:check_pairs"


@dataclass(frozen=True)
class Deviation:
    """A number or curve that deviates from its regression baseline; `str` describes it in one sentence."""

    experiment: str
    drive: str
    row: CheckRow

    def __str__(self) -> str:
        row, at = self.row, "" if self.row.at is None else f" at {self.row.at:g} s"
        head = f"{self.experiment}, {self.drive}: {row.name} is {row.word}"
        if row.now is None or row.before is None:
            return head
        return f"{head}: {row.now:.6g} {row.unit}{at}, was {row.before:.6g} within {row.bound:g}"


def check(experiment: str | Path, drive: str | None = None, baselines: str | Path | None = None) -> list[Deviation]:
    """Run an experiment and compare it with its stored regression baselines; writes nothing.

    Args:
        experiment: its file or name, see `experiment_file`.
        drive: a drive of fmus/, an FMU, or "own" for the experiment's; None for every drive that has a baseline.
        baselines: folder written by `twin check --update`; None to use `baseline_folder_of`.

    Returns:
        The deviations; empty if everything is unchanged.

    Raises:
        InputRefused: no baseline, an incomparable one, or a measure that is undefined for this run.
        ComponentFailed, SafetyTrip: the run ended early.
    """
    file = experiment_file(experiment)
    folder = stored.baseline_folder_of(file, update=False) if baselines is None else Path(baselines)
    drives = [drive] if drive is not None else stored.stored_drives(folder, file.stem)
    if not drives:
        raise InputRefused(_no_baseline(folder, file, stored.OWN_DRIVE))
    found = []
    for name in drives:
        baseline = stored_baseline(folder, file, name)
        loaded, now = measure_with_drive(file, name)
        found += [Deviation(loaded.name, name, row) for row in verdict(loaded, name, baseline, now).deviations]
    return found


def measure_with_drive(file: Path, drive: str) -> tuple[Experiment, Measurement]:
    experiment = _load(file, drive)
    return experiment, measure_signals(experiment, run_for_measures(experiment))


def stored_baseline(folder: Path, file: Path, drive: str) -> stored.Baseline:
    """Return the regression baseline of the experiment in `file` with a drive; refuse if there is none."""
    known = stored.known_baseline(folder, file.stem, drive)
    if known is None:
        # report a misspelt experiment or drive first
        _load(file, drive)
        raise InputRefused(_no_baseline(folder, file, drive))
    return known


def _load(file: Path, drive: str) -> Experiment:
    return load_experiment(file, drive=None if drive == stored.OWN_DRIVE else drive)


def _no_baseline(folder: Path, file: Path, drive: str) -> str:
    # baselines shipped with twin are read-only
    folder = stored.BASELINE_FOLDER if folder == PROJECT_FOLDER / stored.BASELINE_FOLDER else folder
    elsewhere = [] if folder == stored.BASELINE_FOLDER else ["--baselines", str(folder)]
    accept = shlex.join(["twin", "check", str(file), "--drive", drive, *elsewhere, "--update"])
    return (
        f"{stored.baseline_file(folder, file.stem, drive)}: no baseline of {file.stem}; accept its present values: "
        f'{accept} --reason "first"'
    )


@dataclass(frozen=True)
class Pair:
    """An experiment and a drive to be checked against their regression baseline."""

    file: str
    drive: str
    folder: str


@dataclass(frozen=True)
class CheckOutcome:
    """Outcome of checking one experiment with one drive against its baseline.

    Attributes:
        verdict: None if the run could not be measured or compared.
        text: baseline file after an update; "" if unchanged or if no update was requested.
        failure: error message without a verdict; "" with one.
    """

    pair: Pair
    verdict: CheckVerdict | None
    text: str = ""
    failure: str = ""
    exit_code: int = 0


def pairs(
    experiments: Sequence[Path], drives: Sequence[str], baselines: Path | None, update: bool = False
) -> list[Pair]:
    """List the pairs of experiment and drive to check for a command line of `twin check`.

    Args:
        drives: values of --drive; empty for the drives with a baseline, or the experiment's own.
    """
    files = [experiment_file(experiment) for experiment in experiments]
    if not experiments:
        baselines = baselines or (stored.BASELINE_FOLDER if update else stored.default_baseline_folder())
        files = [_file_of(name) for name in stored.stored_experiments(baselines)]
    if not files:
        raise InputRefused(
            f"{baselines}: no baselines there; name an experiment: twin check EXPERIMENT --update --reason TEXT, or "
            "their folder: --baselines DIR"
        )
    shipped = [fmu.stem for fmu in sorted(locate_file("fmus", Path.cwd()).glob("*/*.fmu"))]
    named = [name for drive in drives for name in (shipped if drive == ALL_DRIVES else [drive])]
    for name in named:
        if name != stored.OWN_DRIVE and not any(
            Path(locate_drive(name, file.resolve().parent)).exists() for file in files
        ):
            raise InputRefused(f"--drive {name}: no such drive; expected an .fmu file, a folder of fmus/, own or all")
    folders = {file: baselines or stored.baseline_folder_of(file, update) for file in files}
    return [
        Pair(str(file), drive, str(folder))
        for file, folder in folders.items()
        # a missing baseline is reported by the check itself
        for drive in dict.fromkeys(named or stored.stored_drives(folder, file.stem) or [stored.OWN_DRIVE])
    ]


def _file_of(name: str) -> Path:
    """Return the file of an experiment with a baseline; a deleted file is reported when its pair is checked."""
    here = Path(f"{name}.toml")
    return here if here.is_file() else locate_file(f"experiments/{name}.toml", Path.cwd())


def check_pairs(reporter: Any, work: Sequence[Pair], date: str, reason: str) -> None:
    """Check pairs of experiment and drive in a worker process, and send each outcome as a note."""
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
        experiment, now = measure_with_drive(file, pair.drive)
        return CheckOutcome(pair, verdict(experiment, pair.drive, before, now))
    known = stored.known_baseline(folder, file.stem, pair.drive)
    experiment, now = measure_with_drive(file, pair.drive)
    text = stored.accepted_text(experiment, pair.drive, now, known, date, reason)
    return CheckOutcome(pair, verdict(experiment, pair.drive, known, now), text)


def outcomes(pairs: Sequence[Pair], reason: str, processes: int, say: Say) -> list[CheckOutcome]:
    """Check pairs in several processes (0: in this one, which a crash ends); return outcomes in order."""
    arguments: dict[str, Any] = {"date": date.today().isoformat(), "reason": reason}
    found: dict[Pair, CheckOutcome] = {}

    say(f"0 of {len(pairs)} checks", 0.0)

    def on_outcome(note: dict[str, Any]) -> None:
        outcome = TypeAdapter(CheckOutcome).validate_python(note)
        found[outcome.pair] = outcome
        say(f"{len(found)} of {len(pairs)} checks", len(found) / len(pairs))

    if processes == 0:
        check_pairs(DirectReporter(on_outcome), pairs, **arguments)
    else:
        stop = threading.Event()
        with ThreadPoolExecutor(processes) as pool:
            # every n-th pair per process, because speed depends far more on the drive than on the experiment
            shares = [pairs[start::processes] for start in range(min(processes, len(pairs)))]
            running = [pool.submit(_check_share, share, arguments, on_outcome, stop) for share in shares]
            try:
                for share in running:
                    share.result()
            except BaseException:
                stop.set()
                raise
    return [found[pair] for pair in pairs]


def _check_share(
    pairs: Sequence[Pair],
    arguments: dict[str, Any],
    on_outcome: Callable[[dict[str, Any]], None],
    stop: threading.Event,
) -> None:
    """Check some pairs in one process; if a drive ends it, continue with the remaining pairs in a new process."""
    left = list(pairs)

    def on_note(note: dict[str, Any]) -> None:
        del left[0]
        on_outcome(note)

    def show(done: int, total: int) -> None:
        # the main thread alone receives Ctrl-C
        if stop.is_set():
            raise KeyboardInterrupt

    while left and not stop.is_set():
        try:
            run_guarded(CHECK_JOB, {"work": left, **arguments}, listen=on_note, show=show)
        except TwinError as failure:
            if not left:
                raise
            on_note(asdict(CheckOutcome(left[0], None, failure=str(failure), exit_code=failure.exit_code)))
