"""Execution of a study for its command: calls it, prints its answers, reports a crash of an FMU as an error message."""

import inspect
from collections.abc import Callable, Iterable, Mapping
from dataclasses import replace
from pathlib import Path
from typing import Any

from twin.cli.streams import print_answer
from twin.cli.terminal import TerminalDisplay
from twin.kernel.errors import ComponentFailed, InputRefused
from twin.kernel.process.guard import JobFailure, run_guarded
from twin.kernel.process.job import (
    JobLimits,
    interrupt_message,
    interruption,
    load_function,
    recording_status,
)
from twin.studies.command import (
    SHARED_OPTIONS,
    Answer,
    Isolation,
    JobIsolation,
    Study,
    StudyInterrupt,
    answer_of,
    run_isolated,
)

NoteListener = Callable[[dict[str, Any]], None]
RECORD_JOB = "twin.studies.command:answer_recording"
LIMIT_OPTIONS = ("limit_step", "limit_wall")
"""Options with the limits of a process, in the order of `JobLimits`."""


def ask(function: Callable[..., Any], given: Mapping[str, Any]) -> None:
    """Run a study for a command: print its answers as text or JSON, and end the process with its exit code.

    SystemExit: the code is not 0. InputRefused: limits of a process without a process (--isolate none). TwinError: the
    study raised one, or an FMU ended its process, see `run_isolated` and `run_recording_job`.
    """
    marked: Study = vars(function)["study"]
    own = inspect.signature(function).parameters
    asked = {key: value for key, value in given.items() if key in own}
    if marked.limited and given["isolate"] == "none":
        for option in LIMIT_OPTIONS:
            if given[option] != SHARED_OPTIONS[option][1]:
                raise InputRefused(
                    f"--{option.replace('_', '-')} is of the process that --isolate none does without; leave one of "
                    "them out"
                )
    more_facts = {key: value for look in marked.before for key, value in (look(asked) or {}).items()}
    code = 0
    try:
        for answer in _answers(function, marked, own, asked, given):
            answer = _add_page(answer) if given.get("report") else answer
            answer = replace(answer, facts={**answer.facts, **more_facts}) if more_facts else answer
            print_answer(answer, given.get("as_json", False))
            code = max(code, answer.exit_code)
    except ComponentFailed as failure:
        more = marked.on_failure(asked) if marked.on_failure else ""
        raise ComponentFailed("\n".join(filter(None, [str(failure), more]))) from None
    if code:
        raise SystemExit(code)


def _add_page(answer: Answer) -> Answer:
    """Write the report page about the recording of `answer`, and add the page's path to `answer`."""
    # imported here: drawing takes a while to load
    from twin.report.page.page import write_report

    page = write_report([Path(answer.facts["recording"])]).facts["page"]
    return replace(answer, text=f"{answer.text}\n  page       {page}", facts=answer.facts | {"page": page})


def _answers(
    function: Callable[..., Any],
    marked: Study,
    own: Mapping[str, object],
    asked: dict[str, Any],
    given: Mapping[str, Any],
) -> Iterable[Answer]:
    """Yield the answers of a study, one after the other; show its progress meanwhile."""
    shared = {key: default if key in own else given.get(key, default) for key, (_, default) in SHARED_OPTIONS.items()}
    name = f"{function.__module__}:{function.__name__}"
    limits = JobLimits(*(given.get(key, SHARED_OPTIONS[key][1]) for key in LIMIT_OPTIONS))
    apart = marked.isolated is True or given.get(str(marked.isolated))
    isolate: JobIsolation = shared["isolate"] if apart else "none"
    if "reporter" in own:
        with TerminalDisplay() as display:
            done = run_recording_job(RECORD_JOB, {"name": name, "asked": asked}, display, isolate, limits)
        yield Answer(**done)
    elif "say" not in own:
        found = function(**asked)
        yield from [answer_of(found)] if found else []
    else:
        several = inspect.isgeneratorfunction(function)
        with TerminalDisplay(loading=False) as display:
            if "isolate" in given or not several:
                display.watch()
            if several:
                answers = function(**asked, say=display.say)
            else:
                answers = [
                    run_isolated(name, asked, display.say, isolate, limits, shared["formats"], shared["columns"])
                ]
            for answer in answers:
                display.clear()
                yield answer_of(answer)


def run_recording_job(
    job: str,
    arguments: dict[str, Any],
    display: TerminalDisplay,
    isolate: Isolation,
    limits: JobLimits,
    on_note: NoteListener | None = None,
) -> Any:
    """Run a job that records runs and return its result; error messages include the state of the recording.

    Arguments are as of `run_guarded`; with the isolation "none" it runs in this process, and without `on_note` the
    display gets its notes. ComponentFailed: an FMU crashed, hung or ended the process after stepping had begun.
    StudyInterrupt: Ctrl-C, after the folder was created. TwinError: the job raised one.
    """
    on_note = on_note or display.on_note
    try:
        if isolate == "none":
            from twin.kernel.process.exits import EXIT_MESSAGE, report_exit
            from twin.kernel.process.reporter import DirectReporter

            with report_exit(lambda: f"{EXIT_MESSAGE}\n{recording_status(display.folder)}"):
                return load_function(job)(DirectReporter(on_note, display.show), **arguments)
        return run_guarded(job, arguments, limits, on_note, display.show)
    except JobFailure as failure:
        raise ComponentFailed(f"{failure}\n{recording_status(display.folder)}") from None
    except KeyboardInterrupt:
        if display.folder is None:
            raise
        continuing = "the same command and" if job == RECORD_JOB else "twin run"
        interrupted = StudyInterrupt(interrupt_message(display.folder, continuing))
        interrupted.exit_code, _ = interruption()
        raise interrupted from None
