"""`twin doctor`: what this installation has and lacks."""

from typing import Annotated

import typer

from twin.cli.early import examine
from twin.cli.options import AsJson


def doctor(
    with_run: Annotated[bool, typer.Option("--run", help="Run one second of Fig. 4, too.")] = False,
    as_json: AsJson = False,
) -> None:
    """Say what this installation has and lacks, and what to do about it.

    Exit code: 0 ready, even if something optional is missing, 2 not ready.

    Example: twin doctor
    """
    code = examine(as_json, with_run)
    if code:
        raise SystemExit(code)
