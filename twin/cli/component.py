"""`twin component`: parts of the robot of another make."""

from pathlib import Path
from typing import Annotated

import typer

from twin.cli.ask import ask
from twin.cli.completion import experiment_files, role_names
from twin.cli.group import Group
from twin.cli.options import JOB_ISOLATION, AsJson, Isolate, Settings
from twin.studies.first_look import find_experiments

app = typer.Typer(cls=Group)


@app.callback()
def component() -> None:
    """Look at and check parts of the robot of another make."""


@app.command("list")
def list_(as_json: AsJson = False) -> None:
    """List the parts that may be of another make, and the ports of each.

    Exit code: 0 in any case.

    Example: twin component list
    """
    ask("twin.studies.qualify.part_check:contracts", {}, as_json)


@app.command()
def check(
    role: Annotated[str, typer.Argument(metavar="ROLE", help="Which part: controller ..", autocompletion=role_names)],
    part: Annotated[
        str | None, typer.Argument(metavar="PART", help="FMU, or FILE.py:CLASS; else the experiment's.")
    ] = None,
    experiment: Annotated[
        Path, typer.Option(metavar="FILE", help="Whose run it gets the inputs of.", autocompletion=experiment_files)
    ] = Path("fig4_force_position"),
    settings: Settings = None,
    isolate: Isolate = JOB_ISOLATION,
    as_json: AsJson = False,
) -> None:
    """Check a part of another make: ports, units, finite, repeatable, reset, state, when it answers, cost.

    Mapping and parameters are set as in an experiment:
    --set controller.parameters.kp=3

    Exit code: 0 it can take its place, 1 not, 2 refused before it was called,
    3 it crashed, hung or ended its process.

    Example: twin component check controller fmus/parts/paper_law
    """
    find_experiments({"experiment": experiment})
    asked = {"role": role, "part": part, "experiment": experiment, "settings": settings or []}
    ask("twin.studies.qualify.part_check:part_check", asked, as_json, isolate)
