"""The command `twin`, and how every error becomes one message and an exit code."""

import sys
from typing import Annotated

import typer

from twin import __version__
from twin.cli import (
    accuracy,
    analyse,
    check,
    compare,
    converge,
    doctor,
    drive,
    export,
    faults,
    identify,
    init,
    replay,
    report,
    run,
    schema,
    sweep,
    tune,
)
from twin.cli.terminal import guard_terminal
from twin.errors import InputRefused, TwinError, plain

INTERRUPTED = 130

app = typer.Typer(name="twin", no_args_is_help=True, pretty_exceptions_enable=False)


def _print_version(wanted: bool) -> None:
    if wanted:
        print(f"twin {__version__}")
        raise typer.Exit()


@app.callback()
def twin(
    version: Annotated[
        bool, typer.Option("--version", is_eager=True, callback=_print_version, help="Print the version and exit.")
    ] = False,
) -> None:
    """Digital twin of a delta-like massage robot with motor drives as FMUs.

    Start with: twin run experiments/fig4_force_position.toml
    """


app.command("run", cls=run.Command)(run.run)
app.command("compare")(compare.compare)
app.command("check")(check.check)
app.command("faults")(faults.faults)
app.add_typer(sweep.app, name="sweep")
app.command("report")(report.report)
app.command("replay")(replay.replay)
app.command("converge")(converge.converge)
app.command("accuracy")(accuracy.accuracy)
app.command("identify")(identify.identify)
app.command("export")(export.export)
app.command("analyse")(analyse.analyse)
app.command("tune")(tune.tune)
app.add_typer(drive.app, name="drive")
app.command("init")(init.init)
app.command("schema")(schema.schema)
app.command("doctor")(doctor.doctor)


def main() -> None:
    """Entry point; ends the process with the exit code of what happened."""
    guard_terminal()
    try:
        code = app(prog_name="twin", standalone_mode=False)
        # Typer makes this of Ctrl-C where no command has more to say about it
        if code == INTERRUPTED:
            print("interrupted", file=sys.stderr)
        sys.exit(code)
    except TwinError as error:
        print(plain(str(error)), file=sys.stderr)
        sys.exit(error.exit_code)
    except typer.TyperException as mistake:
        told = _sentence(mistake)
        if told:
            print(plain(told), file=sys.stderr)
        sys.exit(InputRefused.exit_code)


def _sentence(mistake: typer.TyperException) -> str:
    """A mistake in the command line: where, what, and what is meant or where help is; "" if the help was shown."""
    text = mistake.format_message().strip()
    context = getattr(mistake, "ctx", None)
    if not text or context is None:
        return text
    text = f"{context.command_path}: {text[0].lower()}{text[1:].rstrip('.')}".replace(". Did you", "; did you")
    return text if text.endswith("?") else f"{text}; see {context.command_path} --help"
