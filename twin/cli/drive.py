"""`twin drive`: look at drive FMUs, qualify and compare them, bring new ones in."""

import math
import shlex
import sys
import textwrap
from dataclasses import replace
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

from twin.cli.ask import answer_of, show
from twin.cli.completion import drive_names, experiment_files
from twin.cli.drive_survey import survey
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
from twin.runs.guard.limits import Limits
from twin.writing import json_text

if TYPE_CHECKING:
    from twin.drive.variable import Variable
    from twin.experiment.schema import Drive
    from twin.runs.assembly.drives import DrivePlan

WIDTH = 80

app = typer.Typer(help="Look at drive FMUs, qualify, compare and bring them in.", no_args_is_help=True)
app.command("survey")(survey)

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
    from twin.drive.doubt import RolesUnclear
    from twin.experiment.drive_files import lone_drive
    from twin.runs.assembly.drives import fmus, planned
    from twin.studies.qualify.variables import variables_facts, variables_text

    table = lone_drive(str(fmu), Path.cwd())
    if compile_:
        _build(table)
    try:
        plan = planned(table)
    except RolesUnclear:
        parts = fmus(table)
        print(json_text({"variables": variables_facts(parts)}) if as_json else variables_text(parts))
        raise
    print(json_text(_facts(plan)) if as_json else _table(plan))


@app.command("list")
def list_(as_json: AsJson = False) -> None:
    """List the drives of fmus/ and whether they fit this robot, without loading their binaries.

    Exit code: 0 whether they fit or not, 2 there is no fmus/.

    Example: twin drive list
    """
    from dataclasses import asdict

    from twin.studies.qualify.shelf import shelf_text, shelved_drives

    drives = shelved_drives(Path.cwd())
    print(json_text([asdict(shelved) for shelved in drives]) if as_json else shelf_text(drives))


@app.command()
def new(
    fmus: Annotated[
        list[str],
        typer.Argument(metavar="FMU...", help="An .fmu file; several that make one drive; or a .ssp archive of them."),
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
    from twin.studies.qualify.beginning import begun

    mapping, complete = begun(fmus, Path.cwd())
    print(f"{mapping}\n" + ("complete" if complete else "NOT complete: remove the # from one line of each choice"))
    print(f"then: {shlex.join(['twin', 'drive', 'check', str(mapping)])}")


@app.command()
def check(
    fmus: Annotated[
        list[str],
        typer.Argument(
            metavar="FMU...", help="Drives: .fmu files, folders, names in fmus/.", autocompletion=drive_names
        ),
    ],
    out: Annotated[Path, typer.Option(metavar="DIR", help="Where the picture goes.")] = Path("results/drive_check"),
    as_table: Annotated[bool, typer.Option("--table", help="Print one Markdown table of all drives.")] = False,
    isolate: Isolate = JOB_ISOLATION,
    limit_step: LimitStep = Limits.step,
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

    answers = []
    for fmu in fmus:
        if compile_:
            _build(lone_drive(fmu, Path.cwd()))
        asked = {"fmu": fmu, "out": out, "apart": isolate == JobIsolation.RUN, "sure": yes}
        limits = Limits(limit_step, limit_wall)
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
    fmus: Annotated[
        list[str], typer.Argument(metavar="FMU...", help="Drives, as for check.", autocompletion=drive_names)
    ],
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
    limit_step: LimitStep = Limits.step,
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
    asked = {"fmus": fmus, "experiments": experiments, "settings": settings or [], "body": body, "out": out}
    limits = Limits(limit_step, limit_wall)
    answer = answer_of("twin.studies.qualify.study:compare_drives", asked, isolate, limits, formats, columns)
    if html:
        from twin.report.page.drives import write_drives_page

        page = write_drives_page(answer.facts, out)
        answer = replace(answer, text=f"{answer.text}\npage     {page}", facts=answer.facts | {"page": str(page)})
    show(answer, as_json)
    if answer.exit_code:
        raise SystemExit(answer.exit_code)


def _facts(plan: "DrivePlan") -> dict[str, object]:
    from twin.drive.setting import told
    from twin.drive.steps import abilities

    return {
        "command": plan.table.command,
        "fmus": [
            {
                "part": part,
                "file": str(fmu.path),
                "sha256": fmu.sha256,
                "fmi_version": fmu.model.fmiVersion,
                "kind": fmu.kind,
                "kinds": list(fmu.kinds),
                "solver": solver._asdict() if (solver := plan.solver(part)) else None,
                "tolerance": plan.tolerance(part),
                "model_name": fmu.model.modelName,
                "description": fmu.model.description,
                "generation_tool": fmu.model.generationTool,
                "platforms": list(fmu.platforms),
                "abilities": [f"{name}: {text}" for name, text in abilities(fmu)],
                "parameters": {v.name: _parameter(v) for v in fmu.parameters},
                "get_set_state": bool(fmu.interface.canGetAndSetFMUstate),
                "validation": fmu.warnings(),
            }
            for part, fmu in plan.parts.items()
        ],
        "roles": {
            b.port.name: {"variable": b.said, "causality": b.role.causality, "unit": b.variable.unit, "gain": b.gain}
            for b in plan.bindings
        },
        "wires": {target: source for source, target in plan.wires},
        "set": {part: {v.name: told(value) for v, value in settings} for part, settings in plan.settings.items()},
        "warnings": plan.warnings(),
    }


def _parameter(v: "Variable") -> dict[str, object]:
    numbers = {"start": v.start, "min": v.low, "max": v.high}
    stated = {key: None if math.isnan(value) else value for key, value in numbers.items()}
    named = {"values": dict(v.items)} if v.items else {}
    return {"unit": v.unit or None, **stated, **named, "description": v.description}


def _table(plan: "DrivePlan") -> str:
    from twin.drive.description import KIND_NAMES
    from twin.drive.setting import told
    from twin.drive.steps import abilities
    from twin.runs.assembly.drives import qualified

    lines: list[str] = []
    for part, fmu in plan.parts.items():
        lines += [
            f"{part + ': ' if part else ''}{fmu.path.name}  {fmu.model.modelName}, "
            f"FMI {fmu.model.fmiVersion} {KIND_NAMES[fmu.kind]}",
            *textwrap.wrap(fmu.model.description or "", WIDTH, initial_indent="  ", subsequent_indent="  "),
            f"  sha256     {fmu.sha256}",
            f"  binaries   {', '.join(fmu.platforms)}",
            f"  made with  {fmu.model.generationTool or 'not stated'}",
            *(f"  {name:<9}  {text}" for name, text in abilities(fmu)),
            *_solver_lines(plan, part),
            "",
        ]
    lines.append(f"Commanded with a {plan.table.command}; mapped by name, unit and causality:")
    for b in plan.bindings:
        arrow = "<-" if b.role.causality == "input" else "->"
        unit = f"[{b.variable.unit}]" if b.variable.unit else "[no unit]"
        lines.append(f"  {b.port.name:10} {arrow} {b.said:20} {unit:9} {b.port.meaning}"[:WIDTH])
    lines += [f"  {source} -> {target}  (wire)" for source, target in plan.wires]
    for part, settings in plan.settings.items():
        texts = [(v, v.told(value) if isinstance(value, float) else str(told(value))) for v, value in settings]
        lines += [f"  {qualified(part, v.name)} = {text} {v.unit}  (set)" for v, text in texts]
    for part, fmu in plan.parts.items():
        offered = fmu.parameters
        lines += ["", f"Parameters{' of ' if part else ''}{part}" if offered else "No parameters"]
        columns = [[text(v) for v in offered] for text in (lambda v: v.name, _start, _unit)]
        wide = [max(map(len, column), default=0) for column in columns]
        for v in offered:
            head = f"  {v.name:{wide[0]}} {_start(v):>{wide[1]}} {_unit(v):{wide[2]}} "
            indent = " " * len(head)
            about = " ".join(filter(None, (v.description, f"One of: {', '.join(v.items)}." if v.items else "")))
            lines += textwrap.wrap(about or "-", WIDTH, initial_indent=head, subsequent_indent=indent)
    warnings = plan.warnings() + [text for fmu in plan.parts.values() for text in fmu.warnings()]
    lines += [line for text in warnings for line in textwrap.wrap(f"warning: {text}", WIDTH, subsequent_indent="  ")]
    return "\n".join(lines)


def _unit(v: "Variable") -> str:
    return v.unit or "1"


def _start(v: "Variable") -> str:
    if v.is_text:
        return v.type
    return f"{v.size} values" if v.size > 1 else v.told(v.start)


def _build(table: "Drive") -> None:
    """Compile what of a drive has no binary, and tell."""
    from twin.drive.description import build

    for fmu in [part.fmu for part in table.parts.values()] or [table.fmu or ""]:
        built = build(Path(fmu))
        if built is not None:
            print(f"{fmu}: built with {built.compiler}; kept in {built.library.parents[2]}", file=sys.stderr)


def _solver_lines(plan: "DrivePlan", part: str) -> list[str]:
    """Who solves its equations, where that is said or could be chosen."""
    fmu, solver = plan.parts[part], plan.solver(part)
    if solver is None:
        return ['  offers     model exchange too: kind = "model_exchange"'] if len(fmu.kinds) > 1 else []
    step = "one step per step of the drive" if solver.step is None else f"steps of {1e3 * solver.step:g} ms at most"
    how = f"relative tolerance {plan.tolerance(part):g}" if solver.method == "cvode" else step
    size = f"{fmu.model.numberOfContinuousStates} states, {fmu.model.numberOfEventIndicators} event indicators"
    return [f"  solver     ours, {solver.method}, {how}; {size}"]
