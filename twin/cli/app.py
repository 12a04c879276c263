"""The command `twin`, and how every error becomes one message and an exit code."""

import sys
from typing import Annotated

import typer

from twin import __version__
from twin.cli import (
    accuracy,
    analyse,
    build,
    check,
    compare,
    component,
    converge,
    cosim,
    doctor,
    drive,
    export,
    falsify,
    faults,
    identify,
    init,
    replay,
    report,
    run,
    runs,
    schema,
    sweep,
    tune,
)
from twin.cli.group import Group
from twin.cli.options import as_spelt_now
from twin.cli.streams import READER_GONE, Unread, standard_streams
from twin.cli.terminal import guard_terminal
from twin.errors import InputRefused, NotWritten, TwinError, plain, system_sentence
from twin.runs.guard.interrupt import INTERRUPTED

app = typer.Typer(name="twin", cls=Group, pretty_exceptions_enable=False, rich_markup_mode=None)


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
app.command("falsify")(falsify.falsify)
app.add_typer(sweep.app, name="sweep")
app.command("runs")(runs.runs)
app.command("report")(report.report)
app.command("replay")(replay.replay)
app.command("converge")(converge.converge)
app.command("accuracy")(accuracy.accuracy)
app.command("identify")(identify.identify)
app.command("export")(export.export)
app.command("build")(build.build)
app.command("cosim")(cosim.cosim)
app.command("analyse")(analyse.analyse)
app.command("tune")(tune.tune)
app.add_typer(drive.app, name="drive")
app.add_typer(component.app, name="component")
app.command("init")(init.init)
app.command("schema")(schema.schema)
app.command("doctor")(doctor.doctor)


def main() -> None:
    """Entry point; ends the process with the exit code of what happened."""
    with standard_streams():
        guard_terminal()
        code, told = _ended()
        if told:
            print(plain(told), file=sys.stderr)
    sys.exit(code)


def _ended() -> tuple[int | str | None, str]:
    """Exit code of the command, and a sentence on what went wrong; "" if nothing did, or it has been told."""
    try:
        try:
            code = app(as_spelt_now(sys.argv[1:]), prog_name="twin", standalone_mode=False)
            # Typer makes this of Ctrl-C where no command has more to say about it
            told = "interrupted" if code == INTERRUPTED else ""
        except SystemExit as end:
            code, told = end.code, ""
        sys.stdout.flush()
        return code, told
    except Unread:
        return READER_GONE, ""
    except TwinError as error:
        return error.exit_code, str(error)
    except typer.TyperException as mistake:
        return InputRefused.exit_code, _sentence(mistake)
    except OSError as problem:
        return NotWritten.exit_code, system_sentence(problem)


def _sentence(mistake: typer.TyperException) -> str:
    """A mistake in the command line: where, what, and what is meant or where help is; "" if the help was shown."""
    text = mistake.format_message().strip()
    context = getattr(mistake, "ctx", None)
    if not text or context is None:
        return text
    text = f"{context.command_path}: {text[0].lower()}{text[1:].rstrip('.')}".replace(". Did you", "; did you")
    return text if text.endswith("?") else f"{text}; see {context.command_path} --help"
