"""The matrix of faults, from an experiment's file to files: rows, picture, facts."""

from collections.abc import Sequence
from pathlib import Path

from twin.runs.assembly.load import load_experiment
from twin.studies.answer import Answer
from twin.studies.faults.case import cases, known_kinds
from twin.studies.faults.matrix import healthy_trial, matrix_rows, onsets_of
from twin.studies.faults.picture import draw_fault_matrix
from twin.studies.faults.text import fault_matrix_text
from twin.studies.steps import Say
from twin.writing import growing, json_text, made_folder, write_json

HOME = Path("results") / "faults"
ROWS, MATRIX, PICTURE = "rows.jsonl", "matrix.json", "matrix.png"


def break_everything(
    experiment: Path,
    kinds: Sequence[str],
    onsets: Sequence[float],
    duration: float | None,
    drive: str | None,
    body: str | None,
    settings: Sequence[str],
    out: Path | None,
    say: Say,
) -> Answer:
    """What each fault does to an experiment, and files in `out`, or results/faults/EXPERIMENT.

    Each row is written as soon as there is one, so that a drive that crashes costs none of them. Exit code 1: a fault
    is missed, or the force goes beyond the bound, without having been said to.

    Args:
        experiment: its file or name.
        kinds: see `known_kinds`.
        onsets: see `onsets_of` (s).
        duration: of each fault (s); None: to the end.
        drive: see `load_experiment`.
        body: see `load_experiment`.
        settings: see `load_experiment`.
        out: folder; None: results/faults/EXPERIMENT.
        say: told how many cases are done.

    Raises:
        InputRefused: experiment, kinds, onsets or the folder cannot be used.
        SafetyTrip, ComponentFailed: without any fault, see `healthy_trial`.
        NotWritten: the disk refuses.
    """
    folder = made_folder(out or HOME / experiment.stem)
    name, picture = experiment.stem, folder / PICTURE
    # absolute: an FMU may change the working directory
    home = folder.absolute()
    say("without any fault", 0.0)
    with growing(home / ROWS) as append:
        chosen = known_kinds(kinds)
        loaded = load_experiment(experiment, settings, drive, body)
        healthy = healthy_trial(loaded)
        planned = cases(loaded, chosen, onsets_of(loaded, healthy, onsets), duration)
        rows = []
        for row in matrix_rows(loaded, healthy, planned):
            rows.append(row)
            append(json_text(row.facts()) + "\n")
            say(f"{len(rows)} of {len(planned)} cases", len(rows) / len(planned))
    say("drawing the matrix", 1.0)
    facts = {"experiment": name, "rows": [row.facts() for row in rows]}
    draw_fault_matrix(name, rows, home / PICTURE)
    write_json(home / MATRIX, facts)
    text = f"{fault_matrix_text(name, rows)}\n\n  {picture}"
    return Answer(text, facts, 1 if any(row.fails for row in rows) else 0)
