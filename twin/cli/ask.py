"""Asks a study and prints its answer. If an FMU crashes meanwhile, the command ends with a sentence."""

import sys
from collections.abc import Sequence
from typing import Any

from twin.cli.options import JobIsolation
from twin.cli.terminal import CompileWatch, progress
from twin.errors import ComponentFailed, visible_lines
from twin.runs.guard.guard import JobEnded, JobEndedLoading, guarded
from twin.runs.guard.limits import JobLimits
from twin.studies.answer import JOB, Answer, answered
from twin.writing import json_text


def ask(
    study: str,
    asked: dict[str, Any],
    as_json: bool = False,
    isolate: JobIsolation = JobIsolation.NONE,
    limits: JobLimits = JobLimits(),  # noqa: B008, it is frozen
    formats: Sequence[str] | None = None,
    columns: int = 2,
) -> None:
    """Print what `study` answers, as text or as JSON, and end with its exit code.

    Args: see `answer_of`.

    Raises:
        SystemExit: the exit code is not 0.
    """
    answer = answer_of(study, asked, isolate, limits, formats, columns)
    show(answer, as_json)
    if answer.exit_code:
        raise SystemExit(answer.exit_code)


def answer_of(
    study: str,
    asked: dict[str, Any],
    isolate: JobIsolation = JobIsolation.NONE,
    limits: JobLimits = JobLimits(),  # noqa: B008, it is frozen
    formats: Sequence[str] | None = None,
    columns: int = 2,
) -> Answer:
    """What `study` answers; what it is doing is shown meanwhile.

    Args:
        study: "module:function", see `answered`.
        asked: the function's arguments.
        isolate: what gets a process of its own; a study that steps no FMU needs none.
        limits: of that process.
        formats, columns: of pictures for a paper, besides those for the screen.

    Raises:
        ComponentFailed: an FMU crashed, hung or ended that process. With nothing recorded to lose it is no matter
            whether stepping had begun.
        TwinError: the study raised one.
    """
    shown = progress()
    watch = CompileWatch(shown)
    arguments: dict[str, Any] = {"study": study, "asked": asked, "formats": list(formats or ()), "columns": columns}

    def hear(note: dict[str, Any]) -> None:
        # from the first step that is over on there is a share to show
        if note["share"]:
            watch.end()
        shown.step(note["say"], note["share"])

    if sys.stderr.isatty():
        watch.start()
    try:
        if isolate == JobIsolation.RUN:
            return Answer(**guarded(JOB, arguments, limits, hear))
        from twin.runs.guard.reporter import DirectReporter

        return Answer(**answered(DirectReporter(hear), **arguments))
    except (JobEnded, JobEndedLoading) as failure:
        raise ComponentFailed(str(failure)) from None
    finally:
        watch.end()
        shown.clear()


def show(answer: Answer, as_json: bool) -> None:
    """Print `answer`."""
    # names in a recording are anybody's
    print(json_text(answer.facts) if as_json else visible_lines(answer.text))
