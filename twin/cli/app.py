"""The command `twin`, and how every error becomes one message and an exit code."""

import sys

import typer

from twin.cli import analyse, compare, drive, faults, run
from twin.errors import TwinError

INTERRUPTED = 130

app = typer.Typer(
    name="twin",
    help="Digital twin of a delta-like massage robot: experiments with motor drives as FMUs, beside the paper.",
    no_args_is_help=True,
    add_completion=False,
    pretty_exceptions_enable=False,
)
app.command("run")(run.run)
app.command("compare")(compare.compare)
app.command("faults")(faults.faults)
app.command("analyse")(analyse.analyse)
app.add_typer(drive.app, name="drive")


def main() -> None:
    """Entry point; ends the process with the exit code of what happened."""
    try:
        app()
    except TwinError as error:
        print(error, file=sys.stderr)
        sys.exit(error.exit_code)
    except KeyboardInterrupt:
        print("interrupted", file=sys.stderr)
        sys.exit(INTERRUPTED)
