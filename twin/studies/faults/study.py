"""`twin faults`: the matrix of faults of an experiment."""

from collections.abc import Sequence
from itertools import product
from pathlib import Path
from typing import Annotated

from twin.studies.command import Argument, ArgumentValues, DriveName, Option, Say, Settings, study
from twin.studies.faults import SetOfFaults
from twin.studies.precheck import load_experiments
from twin.studies.result import Result

RESULTS_FOLDER = Path("results") / "faults"
ROWS_FILE, MATRIX_FILE, PICTURE_FILE = "rows.jsonl", "matrix.json", "matrix.png"


def _rows_until_then(asked: ArgumentValues) -> str:
    rows: Path = (asked["out"] or RESULTS_FOLDER / asked["experiment"].stem) / ROWS_FILE
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
    sets: Annotated[
        Sequence[SetOfFaults],
        Option(
            "Single faults, common causes, or pairs of kinds; may be repeated. Default: all three.",
            "single|common|pairs",
            "--set-of",
        ),
    ] = (),
    drive: DriveName = None,
    bodies: Annotated[
        Sequence[str],
        Option(
            "Body to press on, such as back; may be repeated: common causes and pairs are tried on each, worst first.",
            "BODY",
            "--body",
            complete="body",
        ),
    ] = (),
    reach: Annotated[
        float,
        Option(
            "Also move all tasks sideways, by this much in four directions, for common causes and pairs.",
            "MM",
            "--reach-mm",
            least=0.0,
        ),
    ] = 0.0,
    settings: Settings = (),
    out: Annotated[Path | None, Option("Folder; default: results/faults/EXPERIMENT.", "DIR")] = None,
    complete: Annotated[
        bool, Option("Print every kind and every exception, not only the largest forces.", flags="--all")
    ] = False,
) -> Result:
    """Inject each kind of fault, common causes and pairs, with the monitor and without.

    The catalogue of faults states beforehand which ones the monitor detects,
    and which exceed the force limit by more than 20 % all the same. A common
    cause breaks several parts at once, such as all drives. Pairs begin together,
    or, in contact, the second fault 1 s after the first trip. After a common
    cause or a pair the force is to stay below 1.5 times the limit, or 1.2 times
    what an ideal monitor reaches.

    Exit code: 0 as stated, 1 a fault is missed or exceeds the limit
    unexpectedly, 2 input refused, 3 a drive crashed or hung (the rows until
    then are kept), 4 the monitor tripped without any fault.

    Example: twin faults experiments/pressing.toml --kind drive_runaway --onset 6
    """
    from twin.kernel.atomic_write import json_text, make_folder, open_unbuffered, write_json
    from twin.kernel.serialise import to_dict
    from twin.studies.faults.cases import cases, known_kinds
    from twin.studies.faults.matrix import FaultRow, matrix_rows
    from twin.studies.faults.offsets import offsets
    from twin.studies.faults.stage import Stage, load_stage
    from twin.studies.faults.text import combination_result, draw_fault_matrix, fault_matrix_result
    from twin.studies.faults.together import CombinationRow, combination_rows, combinations_of

    folder = make_folder(out or RESULTS_FOLDER / experiment.stem)
    name, picture = experiment.stem, folder / PICTURE_FILE
    # absolute: an FMU may change the working directory
    home = folder.absolute()
    wanted = [SetOfFaults(one) for one in sets] or list(SetOfFaults)
    say("without any fault", 0.0)
    # rows are written one by one so that a crashing drive loses none of them
    with open_unbuffered(home / ROWS_FILE) as append:
        chosen = known_kinds(kinds)
        stages: list[Stage] = []
        for body, offset in product(dict.fromkeys(bodies) or (None,), offsets(1e-3 * reach)):
            stages.append(load_stage(experiment, settings, body, offset, drive, onsets))
            # checks the onsets, too
            planned = cases(stages[-1].experiment, chosen, stages[-1].onsets, duration)
        first = stages[0]
        # single faults on the first body
        planned = cases(first.experiment, chosen, first.onsets, duration) if SetOfFaults.SINGLE in wanted else ()
        begin = [(onset, stage.touches(onset)) for stage in stages for onset in stage.onsets]
        total = len(planned) + sum(len(combinations_of(kind, *at, kinds)) for kind in wanted for at in begin)
        rows: list[FaultRow] = []
        for row in matrix_rows(first, planned):
            rows.append(row)
            append(json_text(row.to_dict()) + "\n")
            say(f"{len(rows)} of {total} cases", len(rows) / total)
        together: list[CombinationRow] = []
        for stage in stages:
            for found in combination_rows(stage, wanted, kinds):
                together.append(found)
                append(json_text(to_dict(found)) + "\n")
                say(f"{len(rows) + len(together)} of {total} cases", (len(rows) + len(together)) / total)
    if not rows:
        result = combination_result(name, together, wanted, complete)
    else:
        say("drawing the matrix", 1.0)
        result = fault_matrix_result(name, rows, picture, together, complete)
        draw_fault_matrix(name, rows, home / PICTURE_FILE)
    write_json(home / MATRIX_FILE, result.facts)
    return result
