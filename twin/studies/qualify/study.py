"""Drives on the bench and in an experiment, from FMUs to pictures and facts."""

from collections.abc import Sequence
from pathlib import Path
from typing import Any

from twin.errors import InputRefused
from twin.experiment.drive_files import lone_drive
from twin.experiment.named import experiment_file
from twin.studies.answer import Answer
from twin.studies.qualify.bench import told
from twin.studies.qualify.comparison import COMPARED, comparison_facts, draw_drive_compare, trials, verdict
from twin.studies.qualify.qualification import qualified
from twin.studies.qualify.text import compare_blocks, draw_drive_check, qualification_result
from twin.studies.qualify.workload import Workload
from twin.studies.reference.outcome import came_with, no_drive, references_text
from twin.studies.result import Block, Note, Result
from twin.studies.steps import Say
from twin.writing import made_folder


def qualify(fmu: str, out: Path, apart: bool, sure: bool, say: Say) -> Result | Answer:
    """What a drive does on the bench, and its picture in `out`; before that, what comes of the files that came with it.

    Exit code 1: it does not qualify, or does something else than those files say. 2: they were tried, but it is no
    drive.

    Args:
        fmu: see `lone_drive`, from here.
        out: folder.
        apart: see `qualified`.
        sure: whether a check that takes more than an hour is meant.
        say: told what is being done.

    Raises:
        InputRefused, ComponentFailed: see `qualified`.
        NotWritten: the disk refuses.
    """
    say(Path(fmu).stem, 0.0)
    folder = made_folder(out)
    table = lone_drive(fmu, Path.cwd())
    came = came_with(table, apart)
    try:
        with told(Workload(Path(fmu).stem, say, sure).take):
            done = qualified(table, apart)
    except InputRefused as refusal:
        if not came:
            raise
        return no_drive(came, str(refusal))
    picture = folder / f"{Path(done.plan.label).stem}.png"
    draw_drive_check(done, picture)
    facts = done.facts() | {"references": [one.facts() for one in came], "picture": str(picture)}
    references = references_text(came) if came else ""
    return qualification_result(facts, references, picture, all(one.holds for one in came))


def compare_drives(
    fmus: Sequence[str],
    experiments: Sequence[Path],
    settings: Sequence[str],
    body: str | None,
    out: Path,
    say: Say,
) -> Result:
    """What truly happens in experiments with one drive after the other, and a picture of each in `out`.

    Exit code 3: a run failed.

    Args:
        fmus: drives.
        experiments: their files or names.
        settings, body: see `trials`.
        out: folder.
        say: told what is being done.

    Raises:
        InputRefused: a drive does not fit; none has run.
        NotWritten: the disk refuses.
    """
    folder, files = made_folder(out), [experiment_file(experiment) for experiment in experiments]
    compared = trials(files, list(fmus), settings, body, say)
    said = verdict(compared)
    facts: list[dict[str, Any]] = []
    blocks: list[Block] = [Note(sentence, later=2, whole=True) for sentence in said] or [""]
    for file, one in zip(files, compared, strict=True):
        picture = folder / f"{file.stem}.png"
        draw_drive_compare(one.trials, f"Drives compared in {file.name}", picture)
        facts.append(comparison_facts(one) | {"picture": str(picture)})
        blocks += ["", one.name, *compare_blocks(one), f"picture  {picture}"]
    everything = {
        "verdict": said,
        "set": [*settings, *([f"body {body}"] if body else [])],
        "definitions": {name: definition._asdict() for name, definition in COMPARED.items()},
        "experiments": facts,
    }
    failed = any(trial.failure for one in compared for trial in one.trials)
    return Result(blocks[0], blocks[1:], everything, exit_code=3 if failed else 0)
