"""`twin drive`: look at drive FMUs, qualify and compare them, bring new ones in."""

import math
import shlex
import sys
from dataclasses import replace
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

from twin.cli import drive_info
from twin.cli.ask import answer_of, show
from twin.cli.completion import drive_names, experiment_files
from twin.cli.group import Group
from twin.cli.options import (
    JOB_ISOLATION,
    AsJson,
    BodyName,
    Columns,
    Compile,
    Formats,
    Isolate,
    JobIsolation,
    LimitStep,
    LimitWall,
    Settings,
)
from twin.errors import InputRefused
from twin.runs.guard.limits import JobLimits
from twin.studies.first_look import load_experiments
from twin.writing import json_text

if TYPE_CHECKING:
    from twin.experiment.schema import Drive


app = typer.Typer(cls=Group)

Fmu = Annotated[
    str,
    typer.Argument(
        metavar="FMU", help="An .fmu file, a mapping, a drive's folder, or a name in fmus/.", autocompletion=drive_names
    ),
]


@app.callback()
def drive() -> None:
    """Look at drive FMUs, qualify, compare and bring them in."""


@app.command()
def info(fmu: Fmu, compile_: Compile = False, as_json: AsJson = False) -> None:
    """Show what a drive FMU is and offers, without loading its binary.

    Where it is unclear which variable plays which role, all that may are listed.

    Exit code: 0 it fits the drive contract, 2 it does not.

    Example: twin drive info pmsm_foc
    """
    from twin.drive.mapping import RolesUnclear
    from twin.experiment.drive_files import lone_drive
    from twin.runs.assembly.drives import fmus, planned
    from twin.studies.qualify.bench import variables_facts, variables_text

    table = lone_drive(str(fmu), Path.cwd())
    if compile_:
        _build(table)
    try:
        plan = planned(table)
    except RolesUnclear:
        parts = fmus(table)
        print(json_text({"variables": variables_facts(parts)}) if as_json else variables_text(parts))
        raise
    print(json_text(drive_info.facts(plan)) if as_json else drive_info.text(plan))


@app.command("list")
def list_(as_json: AsJson = False) -> None:
    """List the drives of fmus/ and whether they fit this robot, without loading their binaries.

    Exit code: 0 whether they fit or not, 2 there is no fmus/.

    Example: twin drive list
    """
    from twin.cli.early import list_drives

    list_drives(as_json)


@app.command()
def new(
    fmus: Annotated[
        list[str],
        typer.Argument(metavar="FMU", help="An .fmu file; several that make one drive; or a .ssp archive of them."),
    ],
) -> None:
    """Write the mapping.toml that brings a foreign FMU in, beside it.

    Several FMUs, or those of a system in an SSP archive (which go into a folder
    of its name), become one drive, with the wires that their names and units or
    the archive leave no doubt about. What is in doubt stands in it as comments.
    An existing mapping.toml is never touched.

    Exit code: 0 written, 2 refused.

    Example: twin drive new fmus/stepper/stepper.fmu
    """
    from twin.studies.qualify.proposal import begun

    mapping, complete = begun(fmus, Path.cwd())
    print(f"{mapping}\n" + ("complete" if complete else "NOT complete: remove the # from one line of each choice"))
    print(f"then: {shlex.join(['twin', 'drive', 'check', str(mapping)])}")


@app.command()
def check(
    fmus: Annotated[
        list[str],
        typer.Argument(metavar="FMU", help="Drives: .fmu files, folders, names in fmus/.", autocompletion=drive_names),
    ],
    out: Annotated[Path, typer.Option(metavar="DIR", help="Where the picture goes.")] = Path("results/drive_check"),
    as_table: Annotated[bool, typer.Option("--table", help="Print one Markdown table of all drives.")] = False,
    isolate: Isolate = JOB_ISOLATION,
    limit_step: LimitStep = JobLimits.step,
    limit_wall: LimitWall = math.inf,
    yes: Annotated[bool, typer.Option("--yes", help="Check what takes more than an hour.")] = False,
    compile_: Compile = False,
    formats: Formats = None,
    columns: Columns = 2,
    as_json: AsJson = False,
) -> None:
    """Qualify drives on the bench: signs, speeds, droop, bandwidth, step, stall, step size, repeatability, cost.

    Reference experiments that came with an FMU (FMI-LS-REF, or NAME_ref.csv
    beside it) are run first and held to its own results.

    Exit code: 0 qualified, 1 not or other results, 2 refused before it ran, 3 an
    FMU crashed, hung or ended its process.

    Example: twin drive check velocity_servo
    """
    from twin.experiment.drive_files import lone_drive

    # a misspelt one is told before any is checked
    tables = [lone_drive(fmu, Path.cwd()) for fmu in fmus]
    answers = []
    for fmu, table in zip(fmus, tables, strict=True):
        if compile_:
            _build(table)
        asked = {"fmu": fmu, "out": out, "apart": isolate == JobIsolation.RUN, "sure": yes}
        limits = JobLimits(limit_step, limit_wall)
        answer = answer_of("twin.studies.qualify.study:qualify", asked, isolate, limits, formats, columns)
        answers.append(answer)
        if as_json or not as_table:
            show(answer, as_json)
        if "refused" in answer.facts:
            raise InputRefused(answer.facts["refused"])
    if as_table and not as_json:
        from twin.studies.qualify.text import measures_table

        print(measures_table([answer.facts for answer in answers]))
    if any(answer.exit_code for answer in answers):
        raise SystemExit(1)


@app.command()
def compare(
    fmus: Annotated[list[str], typer.Argument(metavar="FMU", help="Drives, as for check.", autocompletion=drive_names)],
    experiments: Annotated[
        list[Path],
        typer.Option(
            "--experiment",
            metavar="FILE",
            help="An experiment, file or name; may be repeated.",
            autocompletion=experiment_files,
        ),
    ],
    body: BodyName = None,
    settings: Settings = None,
    out: Annotated[Path, typer.Option(metavar="DIR", help="Where pictures go.")] = Path("results/drive_compare"),
    html: Annotated[bool, typer.Option("--html", help="Write all of it as one page, compare.html, too.")] = False,
    isolate: Isolate = JOB_ISOLATION,
    limit_step: LimitStep = JobLimits.step,
    limit_wall: LimitWall = math.inf,
    formats: Formats = None,
    columns: Columns = 2,
    as_json: AsJson = False,
) -> None:
    """Run the same experiments with one drive after the other, and judge what truly happened.

    First it says in what each drive is better or worse than the first one, then
    the numbers.
    Exit code: 0 all ran, 2 one is refused (none has run), 3 one failed.

    Example: twin drive compare velocity_servo pmsm_foc --experiment experiments/pressing.toml
    """
    load_experiments({"experiments": experiments, "settings": settings, "drives": fmus, "body": body})
    asked = {"fmus": fmus, "experiments": experiments, "settings": settings or [], "body": body, "out": out}
    limits = JobLimits(limit_step, limit_wall)
    answer = answer_of("twin.studies.qualify.study:compare_drives", asked, isolate, limits, formats, columns)
    if html:
        from twin.report.page.drives import write_drives_page

        page = write_drives_page(answer.facts, out)
        answer = replace(answer, text=f"{answer.text}\npage     {page}", facts=answer.facts | {"page": str(page)})
    show(answer, as_json)
    if answer.exit_code:
        raise SystemExit(answer.exit_code)


def _build(table: "Drive") -> None:
    """Compile what of a drive has no binary, and tell."""
    from twin.drive.description import build

    for fmu in [part.fmu for part in table.parts.values()] or [table.fmu or ""]:
        built = build(Path(fmu))
        if built is not None:
            print(f"{fmu}: built with {built.compiler}; kept in {built.library.parents[2]}", file=sys.stderr)
