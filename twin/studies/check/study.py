"""Checks, from experiments' files to a verdict, pictures and, if asked for, new baselines."""

from collections.abc import Sequence
from pathlib import Path

from twin.errors import plain
from twin.studies.answer import Answer
from twin.studies.check.baseline import baseline_file, write_baseline
from twin.studies.check.job import pairs
from twin.studies.check.picture import check_pictures
from twin.studies.check.processes import outcomes
from twin.studies.check.text import check_text
from twin.studies.steps import Say


def check_all(
    experiments: Sequence[Path],
    drives: Sequence[str],
    reason: str,
    baselines: Path | None,
    out: Path,
    processes: int,
    say: Say,
) -> Answer:
    """Whether experiments come to what they came to before; with a reason, what they come to now is accepted.

    Exit code 1: something deviates, and nobody accepts it; that of the first check that could not be done.

    Args:
        experiments: see `pairs`.
        drives: see `pairs`.
        reason: of an update; "": nobody asked for one.
        baselines: folder; None: see `baselines_of`.
        out: folder for pictures of curves outside their tubes.
        processes: see `outcomes`.
        say: told how many are done.

    Raises:
        InputRefused: see `pairs`.
        NotWritten: the disk refuses.
    """
    done = outcomes(pairs(experiments, drives, baselines, bool(reason)), reason, processes, say)
    verdicts = [outcome.verdict for outcome in done if outcome.verdict]
    failures = [outcome for outcome in done if outcome.failure]
    told = [{"experiment": Path(o.pair.file).stem, "drive": o.pair.drive, "failure": o.failure} for o in failures]
    places = []
    moved = [outcome for outcome in done if outcome.text]
    for outcome in moved:
        write_baseline(
            baseline_file(Path(outcome.pair.folder), Path(outcome.pair.file).stem, outcome.pair.drive), outcome.text
        )
    if reason and verdicts:
        folders = dict.fromkeys(outcome.pair.folder for outcome in done if outcome.verdict)
        places.append(f"  written  {len(moved)} of {len(verdicts)} baselines in {', '.join(folders)}")
    say("drawing and writing", 1.0)
    if any(verdict.outside for verdict in verdicts):
        places += [f"  picture  {picture}" for picture in check_pictures(verdicts, out)]
    text = check_text(verdicts, [plain(outcome.failure) for outcome in failures])
    deviates = not reason and any(verdict.deviations for verdict in verdicts)
    return Answer(
        "\n".join([text, *([""] if places else []), *places]),
        {"verdicts": [verdict.facts() for verdict in verdicts], "failures": told},
        failures[0].exit_code if failures else int(deviates),
    )
