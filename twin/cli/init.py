"""`twin init`: an experiment to start from."""

import shlex
from pathlib import Path
from typing import Annotated

import typer

from twin.cli.completion import experiment_names


def init(
    file: Annotated[Path, typer.Argument(metavar="FILE", help="The experiment to write.")] = Path("experiment.toml"),
    start: Annotated[
        str,
        typer.Option("--from", metavar="NAME", help="The experiment to start from.", autocompletion=experiment_names),
    ] = "fig4_force_position",
) -> None:
    """Write an experiment to start from: every key, what it means, its unit, its default.

    It runs as it is, from any folder. Beside it, unless it is there already, goes
    the JSON Schema by which editors check it. No file is ever overwritten.
    Exit code: 0 written, 2 refused.

    Example: twin init my_experiment.toml --from pressing
    """
    from twin.experiment.recorded import start_experiment
    from twin.runs.assembly.declared import DECLARED

    for written in start_experiment(DECLARED, file, start):
        print(written)
    print(f"next: {shlex.join(['twin', 'run', str(file)])}")
