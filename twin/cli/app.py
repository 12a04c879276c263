"""The command `twin`: its subcommands and the errors of a command line."""

from collections.abc import Mapping
from itertools import pairwise
from typing import Annotated, Any

import typer

from twin import __version__
from twin.cli.commands import Commands, Group
from twin.kernel.errors import InputRefused
from twin.studies.command import Isolation


class TwinCommands(Commands):
    """All of them, in the order of the help."""

    ORDER = (
        "run",
        "compare",
        "check",
        "faults",
        "falsify",
        "runs",
        "report",
        "replay",
        "converge",
        "accuracy",
        "identify",
        "export",
        "build",
        "cosim",
        "analyse",
        "tune",
        "init",
        "schema",
        "doctor",
        "sweep",
        "drive",
        "component",
        "log",
    )
    GROUPS: Mapping[str, Group] = {
        "sweep": Group("Run one experiment many times: twin sweep SWEEP, or twin sweep run SWEEP.", default="run"),
        "drive": Group("Look at drive FMUs, qualify, compare and bring them in."),
        "component": Group("Look at and check third-party parts of the robot."),
        "log": Group("Bring in the log of a robot: which column is which signal."),
    }


app = typer.Typer(name="twin", cls=TwinCommands, pretty_exceptions_enable=False, rich_markup_mode=None)


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


def carried_out(words: list[str]) -> Any:
    """Exit code of the command line `words`.

    Raises:
        InputRefused: a mistake in it, in one sentence.
    """
    # not needed to know what commands there are
    from twin.studies.left_behind import clear

    clear()
    try:
        return app(as_spelt_now(words), prog_name="twin", standalone_mode=False)
    except typer.TyperException as mistake:
        raise InputRefused(_sentence(mistake)) from None


def as_spelt_now(words: list[str]) -> list[str]:
    """A command line with --isolate and --no-isolate, as some commands called them, in today's spelling; and with
    --realtime as --realtime=1, because Typer knows no options whose value may be left out."""
    spelt = {"--no-isolate": "--isolate=none", "--realtime": "--realtime=1"}
    return [
        "--isolate=run" if word == "--isolate" and following not in list(Isolation) else spelt.get(word, word)
        for word, following in pairwise([*words, ""])
    ]


def _sentence(mistake: typer.TyperException) -> str:
    """A mistake in the command line: where, what, and what is meant or where help is; "" if the help was shown."""
    text = mistake.format_message().strip()
    context = getattr(mistake, "ctx", None)
    if not text or context is None:
        return text
    text = f"{context.command_path}: {text[0].lower()}{text[1:].rstrip('.')}".replace(". Did you", "; did you")
    return text if text.endswith("?") else f"{text}; see {context.command_path} --help"
