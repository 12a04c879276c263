"""`twin drive` and `twin component`: third-party drives and parts, inspected, qualified on the bench, added."""

import math
import shlex
import sys
from collections.abc import Iterator, Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

from twin.kernel.errors import InputRefused
from twin.kernel.process.job import JobLimits
from twin.studies.command import (
    JOB_ISOLATION,
    Answer,
    Argument,
    AsJson,
    Columns,
    Compile,
    Formats,
    Isolate,
    LimitStep,
    LimitWall,
    Option,
    Say,
    Settings,
    run_isolated,
    study,
)
from twin.studies.precheck import find_experiments
from twin.studies.result import Block, Note, Result

if TYPE_CHECKING:
    from twin.robot.experiment.schema import Drive

FIG4_EXPERIMENT = Path("fig4_force_position")


@study("drive info")
def drive_info(
    fmu: Annotated[
        str, Argument("An .fmu file, a mapping, a drive's folder, or a name in fmus/.", "FMU", complete="drive")
    ],
    say: Say,
    compiled: Compile = False,
) -> Iterator[Answer]:
    """Describe a drive FMU and its variables, without loading its binary.

    If a role is ambiguous, all candidate variables are listed.

    Exit code: 0 it fits the drive contract, 2 it does not.

    Example: twin drive info pmsm_foc
    """
    from twin.robot.assembly.drives import fmus, plan_drive
    from twin.robot.drive.mapping import AmbiguousRoles
    from twin.robot.experiment.drive_files import load_drive
    from twin.studies.qualify.bench import variables_facts, variables_text
    from twin.studies.qualify.drive_list import drive_facts, drive_text

    table = load_drive(fmu, Path.cwd())
    if compiled:
        _build(table)
    try:
        plan = plan_drive(table)
    except AmbiguousRoles:
        parts = fmus(table)
        yield Answer(variables_text(parts), {"variables": variables_facts(parts)})
        raise
    yield Answer(drive_text(plan), drive_facts(plan))


@study("drive list")
def drive_list() -> Answer:
    """List the drives of fmus/ and whether they fit this robot, without loading their binaries.

    Exit code: 0 whether they fit or not, 2 fmus/ does not exist.

    Example: twin drive list
    """
    from twin.studies.qualify.drive_list import drives_text, listed_drives

    drives = listed_drives(Path.cwd())
    return Answer(drives_text(drives), [shelved._asdict() for shelved in drives])


@study("drive new", json=False)
def drive_new(
    fmus: Annotated[
        Sequence[str], Argument("An .fmu file, several that form one drive, or a .ssp archive of them.", "FMU")
    ],
) -> Answer:
    """Write a mapping.toml for a third-party FMU, beside it.

    Several FMUs, or those of a system in an SSP archive (which go into a
    folder of its name), become one drive, with the wires that are clear from
    names, units or the archive. Doubtful lines are comments. An existing
    mapping.toml is never changed.

    Exit code: 0 written, 2 refused.

    Example: twin drive new fmus/stepper/stepper.fmu
    """
    from twin.studies.qualify.proposal import write_mapping

    mapping, complete = write_mapping(fmus, Path.cwd())
    sentences = "complete" if complete else "NOT complete: remove the # from one line of each choice"
    text = f"{mapping}\n{sentences}\nthen: {shlex.join(['twin', 'drive', 'check', str(mapping)])}"
    return Answer(text, {"mapping": str(mapping), "complete": complete})


@study("drive check")
def drive_check(
    fmus: Annotated[Sequence[str], Argument("Drives: .fmu files, folders, names in fmus/.", "FMU", complete="drive")],
    say: Say,
    out: Annotated[Path, Option("Folder of the picture.", "DIR")] = Path("results/drive_check"),
    table: Annotated[bool, Option("Print one Markdown table of all drives.")] = False,
    isolate: Isolate = JOB_ISOLATION,
    limit_step: LimitStep = JobLimits.step,
    limit_wall: LimitWall = math.inf,
    yes: Annotated[bool, Option("Allow a check of more than an hour.")] = False,
    compiled: Compile = False,
    formats: Formats = (),
    columns: Columns = 2,
    as_json: AsJson = False,
) -> Iterator[Answer]:
    """Qualify drives on the bench: signs, speeds, droop, bandwidth, step, stall, step size, repeatability, cost.

    Reference experiments of the FMU (FMI-LS-REF, or NAME_ref.csv beside it)
    are run first and compared with its results.

    Exit code: 0 qualified, 1 not or other results, 2 refused before it ran, 3
    an FMU crashed, hung or ended its process.

    Example: twin drive check velocity_servo
    """
    from twin.robot.experiment.drive_files import load_drive

    # Load all first, so that a misspelt one is reported before any is checked.
    tables = [load_drive(fmu, Path.cwd()) for fmu in fmus]
    answers = []
    for fmu, drive in zip(fmus, tables, strict=True):
        if compiled:
            _build(drive)
        asked = {"fmu": fmu, "out": out, "apart": isolate == "run", "sure": yes}
        limits = JobLimits(limit_step, limit_wall)
        name = "twin.studies.qualify.study:qualify"
        answer = run_isolated(name, asked, say, isolate, limits, formats, columns)
        answers.append(answer)
        if as_json or not table:
            yield answer
        if "refused" in answer.facts:
            raise InputRefused(answer.facts["refused"])
    if table and not as_json:
        from twin.studies.qualify.text import measures_table

        yield Answer(measures_table([answer.facts for answer in answers]), {}, max(a.exit_code for a in answers))


def qualify(fmu: str, out: Path, apart: bool, sure: bool, say: Say) -> Result | Answer:
    """Qualify a drive on the bench with a picture in `out`, after running the reference experiments shipped with it.

    Exit code 1: it does not qualify, or differs from the reference results. 2: the reference experiments ran, but the
    FMU does not fit the drive contract. `apart`: see `qualify_drive`; `sure`: more than an hour is confirmed.
    """
    from twin.kernel.atomic_write import make_folder
    from twin.robot.experiment.drive_files import load_drive
    from twin.studies.qualify.bench import reporting_ticks
    from twin.studies.qualify.definitions import Workload
    from twin.studies.qualify.qualification import qualify_drive
    from twin.studies.qualify.text import draw_drive_check, qualification_result
    from twin.studies.reference.outcome import drive_references, references_text, refusal_answer

    say(Path(fmu).stem, 0.0)
    folder = make_folder(out)
    # Absolute, because an FMU may change the working directory.
    home = folder.absolute()
    table = load_drive(fmu, Path.cwd())
    came = drive_references(table, apart)
    try:
        with reporting_ticks(Workload(Path(fmu).stem, say, sure).count_ticks):
            done = qualify_drive(table, apart)
    except InputRefused as refusal:
        if not came:
            raise
        return refusal_answer(came, str(refusal))
    picture = folder / f"{Path(done.plan.label).stem}.png"
    draw_drive_check(done, home / picture.name)
    facts = done.to_dict() | {"references": [one.to_dict() for one in came], "picture": str(picture)}
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
    """Run experiments with one drive after the other and compare their true signals, with a picture of each in `out`.

    Exit code 3: a run failed.
    """
    from twin.kernel.atomic_write import make_folder
    from twin.robot.experiment.experiment_files import experiment_file
    from twin.studies.qualify.comparison import COMPARED_MEASURES, comparison_facts, draw_drive_compare, trials, verdict
    from twin.studies.qualify.text import compare_blocks

    folder, files = make_folder(out), [experiment_file(experiment) for experiment in experiments]
    # Absolute, because an FMU may change the working directory.
    home = folder.absolute()
    compared = trials(files, list(fmus), settings, body, say)
    sentences = verdict(compared)
    facts: list[dict[str, Any]] = []
    blocks: list[Block] = [Note(sentence, later=2, whole=True) for sentence in sentences] or [""]
    for file, one in zip(files, compared, strict=True):
        picture = folder / f"{file.stem}.png"
        draw_drive_compare(one.trials, f"Drives compared in {file.name}", home / picture.name)
        facts.append(comparison_facts(one) | {"picture": str(picture)})
        blocks += ["", one.name, *compare_blocks(one), f"picture  {picture}"]
    everything = {
        "verdict": sentences,
        "set": [*settings, *([f"body {body}"] if body else [])],
        "definitions": {name: definition._asdict() for name, definition in COMPARED_MEASURES.items()},
        "experiments": facts,
    }
    failed = any(trial.failure for one in compared for trial in one.trials)
    return Result(blocks[0], blocks[1:], everything, exit_code=3 if failed else 0)


def _build(table: "Drive") -> None:
    """Compile missing binaries of a drive's FMUs, and report each on stderr."""
    from twin.kernel.fmi.description import build_binary
    from twin.robot.assembly.drives import is_system

    for fmu in [part.fmu for part in table.parts.values()] or [table.fmu or ""]:
        if is_system(Path(fmu)):
            raise InputRefused(
                f"{fmu}: --compile builds one FMU; run twin cosim {fmu} --compile, which caches the binaries"
            )
        built = build_binary(Path(fmu))
        if built is not None:
            print(f"{fmu}: built with {built.compiler}; kept in {built.library.parents[2]}", file=sys.stderr)


@study("component list")
def component_list() -> Result:
    """List the parts that may be third-party, and the ports of each.

    Exit code: 0 in any case.

    Example: twin component list
    """
    from twin.studies.qualify.part_check import contracts

    return contracts()


@study("component check", before=[find_experiments])
def component_check(
    role: Annotated[str, Argument("Role of the part, such as controller.", "ROLE", complete="role")],
    say: Say,
    part: Annotated[str | None, Argument("FMU or FILE.py:CLASS; default: the experiment's.", "PART")] = None,
    experiment: Annotated[
        Path, Option("Experiment whose run provides the inputs.", "FILE", complete="experiment")
    ] = FIG4_EXPERIMENT,
    settings: Settings = (),
    isolate: Isolate = JOB_ISOLATION,
) -> Answer:
    """Check a third-party part: ports, units, finite values, repeatability, reset, state, latency, cost.

    Mapping and parameters are set as in an experiment:
    --set controller.parameters.kp=3

    Exit code: 0 the part fits, 1 it does not, 2 refused before it was called,
    3 it crashed, hung or ended its process.

    Example: twin component check controller fmus/parts/paper_law
    """
    asked = {"role": role, "part": part, "experiment": experiment, "settings": settings}
    return run_isolated("twin.studies.qualify.part_check:part_check", asked, say, isolate)
