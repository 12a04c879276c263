"""`twin faults`: the matrix of faults of an experiment."""

from collections.abc import Sequence
from pathlib import Path
from typing import Annotated

from twin.studies.command import Argument, Asked, BodyName, DriveName, Option, Say, Settings, study
from twin.studies.first_look import load_experiments
from twin.studies.result import Result

HOME = Path("results") / "faults"
ROWS, MATRIX, PICTURE = "rows.jsonl", "matrix.json", "matrix.png"


def _rows_until_then(asked: Asked) -> str:
    rows: Path = (asked["out"] or HOME / asked["experiment"].stem) / ROWS
    count = rows.read_text().count("\n") if rows.exists() else 0
    return f"Kept until then: {rows} ({count} rows)." if count else ""


@study(draws=True, isolated=True, before=[load_experiments], on_failure=_rows_until_then)
def faults(
    experiment: Annotated[
        Path, Argument("Experiment with a safety monitor (TOML).", "EXPERIMENT", complete="experiment")
    ],
    say: Say,
    kinds: Annotated[Sequence[str], Option("Only this kind of fault; may be repeated.", "KIND", "--kind")] = (),
    onsets: Annotated[
        Sequence[float],
        Option("Time of the fault; may be repeated. Default: once in free air, once in contact.", "S", "--onset"),
    ] = (),
    duration: Annotated[float | None, Option("Duration of each fault; default: to the end of the run.", "S")] = None,
    drive: DriveName = None,
    body: BodyName = None,
    settings: Settings = (),
    out: Annotated[Path | None, Option("Folder; default: results/faults/EXPERIMENT.", "DIR")] = None,
) -> Result:
    """Inject each kind of fault once, with the safety monitor and without.

    The catalogue of faults states beforehand which ones the monitor detects,
    and which exceed the force limit by more than 20 % all the same.

    Exit code: 0 as stated, 1 a fault is missed or exceeds the limit
    unexpectedly, 2 input refused, 3 a drive crashed or hung (the rows until
    then are kept), 4 the monitor tripped without any fault.

    Example: twin faults experiments/pressing.toml --kind drive_runaway --onset 6

    Raises:
        InputRefused: experiment, kinds, onsets or the folder cannot be used.
        SafetyTrip, ComponentFailed: without any fault, see `healthy_trial`.
        NotWritten: the disk refuses.
    """
    from twin.kernel.writing import growing, json_text, made_folder, write_json
    from twin.robot.assembly.load import load_experiment
    from twin.studies.faults.matrix import cases, healthy_trial, known_kinds, matrix_rows, onsets_of
    from twin.studies.faults.text import draw_fault_matrix, fault_matrix_result

    folder = made_folder(out or HOME / experiment.stem)
    name, picture = experiment.stem, folder / PICTURE
    # absolute: an FMU may change the working directory
    home = folder.absolute()
    say("without any fault", 0.0)
    # a row is written as soon as there is one, so that a drive that crashes costs none of them
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
    result = fault_matrix_result(name, rows, picture)
    draw_fault_matrix(name, rows, home / PICTURE)
    write_json(home / MATRIX, result.facts)
    return result
