"""`twin doctor`: what this installation has and lacks."""

from pathlib import Path
from typing import Annotated

import typer

from twin.cli.options import AsJson
from twin.writing import json_text


def doctor(
    with_run: Annotated[bool, typer.Option("--run", help="Run one second of Fig. 4, too.")] = False,
    as_json: AsJson = False,
) -> None:
    """Say what this installation has and lacks, and what to do about it.

    Exit code: 0 ready, even if something optional is missing, 2 not ready.

    Example: twin doctor
    """
    from twin.cli.installation.examination import examination_text, examined, verdict
    from twin.cli.installation.finding import is_ready

    findings = examined(Path.cwd(), with_run)
    if as_json:
        print(json_text({"verdict": verdict(findings), "findings": [finding._asdict() for finding in findings]}))
    else:
        print(examination_text(findings))
    if not is_ready(findings):
        raise SystemExit(2)
