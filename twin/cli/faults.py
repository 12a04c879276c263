"""`twin faults`: the matrix of faults of an experiment."""

import sys
from collections.abc import Callable
from dataclasses import asdict
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

import typer

from twin.cli.completion import experiment_files
from twin.cli.options import JOB_ISOLATION, AsJson, BodyName, DriveName, Isolate, JobIsolation, Settings
from twin.errors import ComponentFailed
from twin.writing import growing, json_text, made_folder, write_json

if TYPE_CHECKING:
    from twin.studies.faults.row import Row

ROWS, MATRIX, PICTURE = "rows.jsonl", "matrix.json", "matrix.png"


def faults(
    experiment: Annotated[
        Path,
        typer.Argument(
            metavar="EXPERIMENT", help="Experiment with a safety monitor (TOML).", autocompletion=experiment_files
        ),
    ],
    kinds: Annotated[
        list[str] | None, typer.Option("--kind", metavar="KIND", help="Only this kind of fault; may be repeated.")
    ] = None,
    onsets: Annotated[
        list[float] | None,
        typer.Option("--onset", metavar="S", help="When; may be repeated. Without it once free, once in contact."),
    ] = None,
    duration: Annotated[
        float | None, typer.Option(metavar="S", help="How long each fault lasts; without it, to the end.")
    ] = None,
    drive: DriveName = None,
    body: BodyName = None,
    settings: Settings = None,
    out: Annotated[
        Path | None, typer.Option(metavar="DIR", help="Where rows, picture and JSON go: results/faults/EXPERIMENT.")
    ] = None,
    as_json: AsJson = False,
    isolate: Isolate = JOB_ISOLATION,
) -> None:
    """Break everything once: each kind of fault, with the safety monitor and without.

    The catalogue of faults says before the run which ones the monitor sees, and
    where the force goes beyond the force limit plus 20 % all the same.
    Exit code: 0 it is so, 1 one is missed or goes beyond without having been
    said to, 2 input refused, 3 a drive crashed or hung (the rows until then are
    kept), 4 the monitor tripped without any fault.

    Example: twin faults experiments/pressing.toml --kind drive_runaway --onset 6
    """
    from twin.studies.faults.picture import draw_fault_matrix
    from twin.studies.faults.text import fault_matrix_text

    folder = out or Path("results/faults") / experiment.stem
    arguments = {
        "experiment": str(experiment),
        "kinds": kinds or [],
        "onsets": onsets or [],
        "duration": duration,
        "drive": drive,
        "body": body,
        "settings": settings or [],
    }
    made_folder(folder)
    with growing(folder / ROWS) as append:
        kept = Kept(folder / ROWS, append)
        try:
            _measure(arguments, isolate, kept)
        finally:
            if sys.stderr.isatty():
                print(file=sys.stderr)
    rows = kept.rows
    facts = {"experiment": experiment.stem, "rows": [row.facts() for row in rows]}
    draw_fault_matrix(experiment.stem, rows, folder / PICTURE)
    write_json(folder / MATRIX, facts)
    print(json_text(facts) if as_json else f"{fault_matrix_text(experiment.stem, rows)}\n\n  {folder / PICTURE}")
    if any(row.fails for row in rows):
        raise SystemExit(1)


class Kept:
    """Rows as they come, each at once in a JSON-lines file, so that a crash costs none of them.

    Args:
        path: of the file. append: appends to it.

    Attributes:
        rows: so far.
    """

    def __init__(self, path: Path, append: Callable[[str], None]):
        self.rows: list[Row] = []
        self.path = path
        self._append = append

    def hear(self, note: dict[str, Any]) -> None:
        """Take a note of `measured`."""
        from twin.studies.faults.row import Row

        self.rows.append(Row.of(note["row"]))
        self._append(json_text(self.rows[-1].facts()) + "\n")
        if sys.stderr.isatty():
            print(f"\r{len(self.rows)} of {note['of']} cases", end="", file=sys.stderr, flush=True)


def _measure(arguments: dict[str, Any], isolate: JobIsolation, kept: Kept) -> None:
    from twin.runs.guard.guard import JobDied, guarded
    from twin.runs.guard.voice import DirectVoice

    if isolate == JobIsolation.NONE:
        measured(DirectVoice(kept.hear, lambda done, total: None), **arguments)
        return
    try:
        guarded("twin.cli.faults:measured", arguments, listen=kept.hear)
    except JobDied as death:
        raise ComponentFailed(f"{death}\nKept until then: {kept.path} ({len(kept.rows)} rows).") from None


def measured(
    voice: Any,
    experiment: str,
    kinds: list[str],
    onsets: list[float],
    duration: float | None,
    drive: str | None,
    body: str | None,
    settings: list[str],
) -> None:
    """Measure the matrix; a job of the guard. Notes: {"row": a row taken apart, "of": how many there will be}."""
    from twin.runs.assembly.load import load_experiment
    from twin.studies.faults.case import cases, known_kinds
    from twin.studies.faults.matrix import healthy_trial, onsets_of, rows

    chosen = known_kinds(kinds)
    loaded = load_experiment(Path(experiment), settings, drive, body)
    voice.loading()
    healthy = healthy_trial(loaded)
    planned = cases(loaded, chosen, onsets_of(loaded, healthy, onsets), duration)
    for row in rows(loaded, healthy, planned):
        voice.note(row=asdict(row), of=len(planned))
