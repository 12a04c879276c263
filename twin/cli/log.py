"""`twin log`: logs of other robots."""

import shlex
from pathlib import Path
from typing import Annotated

import typer

from twin.cli.group import Group
from twin.studies.first_look import find_logs

app = typer.Typer(cls=Group)


@app.callback()
def log() -> None:
    """Bring in the log of a robot: which column is which signal."""


@app.command()
def new(
    file: Annotated[Path, typer.Argument(metavar="CSV", help="A CSV file of a robot.")],
) -> None:
    """Write the column map that brings a robot's CSV file in, beside it.

    Names, units and values say which column is the time, which are the encoders
    of motors and joints, and which is the measured force. What is in doubt stands
    in it as comments. An existing map is never touched.

    Exit code: 0 written, 2 refused.

    Example: twin log new robot.csv
    """
    find_logs({"log": file})
    from twin.recording.logs.proposal import propose

    path, complete = propose(file)
    print(f"{path}\n" + ("complete" if complete else "NOT complete: remove the # from what is right"))
    words = ["twin", "replay", str(file), "--experiment", "fig4_force_position", "--map", str(path)]
    print(f"then, with the experiment that describes the robot: {shlex.join(words)}")
