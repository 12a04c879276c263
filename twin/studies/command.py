"""Declaration and execution of studies: the decorator that turns a function into a command, progress, answer.

The arguments of the function are those of the command line. The command's name is the function's, or the words given
to the decorator (`@study("drive check")`); its help is the docstring up to `Raises:`. Modules named
`twin/studies/NAME.py` or `twin/studies/NAME/study.py`, and those of the command line, are searched for studies; there
is no other registration. Arguments are read without running the study, so such a module imports only their types at
its top, and the computing code inside the function.
"""

import inspect
import math
import os
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, fields, is_dataclass, replace
from functools import wraps
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any, Literal, Protocol, TypeVar

from twin.kernel.atomic_write import make_folder, write_json
from twin.kernel.errors import ComponentFailed, TwinError
from twin.kernel.process.job import INTERRUPT_EXIT_CODE, JobLimits, load_function
from twin.studies.result import Result, render_text, to_json

if TYPE_CHECKING:
    from twin.kernel.process.reporter import Reporter

Function = TypeVar("Function", bound=Callable[..., Any])
Record = TypeVar("Record")
ArgumentValues = Mapping[str, Any]
"""Argument name of a study -> value."""
DEFAULT_PORT = 8765
"""Port of the `--live` server and default of its viewers."""
ANSWER_JOB = "twin.studies.command:answer_study"


@dataclass(frozen=True)
class Option:
    """An option of a study's command line, named `--like-this` after the function's argument.

    Attributes:
        flags: additional names: "--overshoot-percent", "-j --processes", "--try/--no-try".
        complete: source of shell completions: "experiment", "experiment name", "drive", "body", "setting" or "role".
    """

    help: str
    metavar: str | None = None
    flags: str = ""
    least: float | None = None
    most: float | None = None
    complete: str = ""


@dataclass(frozen=True)
class Argument(Option):
    """A positional argument of a study's command line."""


@dataclass(frozen=True)
class Study:
    """Decorator that declares a function as a study; Python callers can still call the function directly.

    An argument whose type is a dataclass, such as `MasterOptions`, is expanded: each field becomes an option. In
    addition the function takes `say` (see `Say`), or `reporter` (see `Reporter`) if it records a run, or neither if it
    is fast. It returns an `Answer`, yields answers as they become available, or prints its own output. Shared options
    such as `--json` are added to the command; a function that needs the value of a shared option declares it as an
    argument.

    Attributes:
        words: command name, if it differs from the function's name.
        draws: whether the study draws pictures; adds `--format` and `--columns`.
        isolated: whether the study steps FMUs and so runs in a separate process unless `--isolate none` is given; or
            the name of the flag that makes it step FMUs.
        limited: whether `--limit-step` and `--limit-wall` of the process are added.
        reported: whether `--report` writes a page of the recording named in the answer's fact `recording`.
        before: validators called with the arguments before the worker process starts, to refuse invalid input at once.
            A mapping returned by a validator is added to the answer's facts.
        on_failure: text appended to the error message if a component fails, such as the location of partial results.
    """

    words: str = ""
    draws: bool = False
    isolated: bool | str = False
    limited: bool = False
    json: bool = True
    reported: bool = False
    before: Sequence[Callable[[ArgumentValues], Mapping[str, Any] | None]] = ()
    on_failure: Callable[[ArgumentValues], str] | None = None

    def __call__(self, function: Function) -> Function:
        function = _with_own_options(function)
        vars(function)["study"] = self
        return function

    def shared_options(self) -> list[str]:
        process = [*(["isolate"] if self.isolated else []), *(["limit_step", "limit_wall"] if self.limited else [])]
        page = ["report"] if self.reported else []
        return [*(["formats", "columns"] if self.draws else []), *(["as_json"] if self.json else []), *page, *process]


study = Study


def options_of(record: type[Record], asked: ArgumentValues) -> Record:
    """Build a dataclass from command-line arguments; missing fields keep their defaults."""
    return record(**{one.name: asked[one.name] for one in fields(record) if one.name in asked})  # type: ignore[arg-type]


def _with_own_options(function: Function) -> Function:
    """Return a study's function with each dataclass argument replaced by the fields of the dataclass."""
    parameters = inspect.signature(function).parameters.values()
    records: dict[str, Any] = {
        one.name: one.annotation
        for one in parameters
        if isinstance(one.annotation, type) and is_dataclass(one.annotation)
    }
    if not records:
        return function

    @wraps(function)
    def called(**asked: Any) -> Any:
        made = {name: options_of(record, asked) for name, record in records.items()}
        return function(**{key: asked[key] for key in asked if key in own}, **made)

    own = {one.name for one in parameters}
    flat = [
        inspect.Parameter(option.name, inspect.Parameter.KEYWORD_ONLY, default=option.default, annotation=option.type)
        if option
        else one.replace(kind=inspect.Parameter.KEYWORD_ONLY)
        for one in parameters
        for option in (fields(records[one.name]) if one.name in records else [None])
    ]
    vars(called)["__signature__"] = inspect.Signature(flat)
    return called  # type: ignore[return-value]


class StudyInterrupt(TwinError):
    """Interrupt of a study by Ctrl-C; the message lists the results that were kept."""

    exit_code = INTERRUPT_EXIT_CODE


JobIsolation = Literal["run", "none"]
JOB_ISOLATION: JobIsolation = "run" if os.name == "posix" else "none"
"""Default of `--isolate`: a guarded process on POSIX, else none."""
Isolation = Literal["run", "drive", "none"]
"""Scope of the separate process of a run; drives can have processes of their own."""
PictureFormat = Literal["svg", "pdf"]

Isolate = Annotated[
    JobIsolation,
    Option("Process for FMUs: a separate one, or none (for debuggers).", flags="--isolate"),
]
LimitStep = Annotated[float, Option("Longest time of one call into a drive.", "S", least=0.0)]
LimitWall = Annotated[float, Option("Longest time of the whole command.", "S", least=0.0)]
Formats = Annotated[
    Sequence[PictureFormat],
    Option("Also write pictures for a paper; may be repeated.", "svg|pdf", "--format"),
]
Columns = Annotated[int, Option("With --format: width in columns of the paper.", "1|2", "--columns", least=1, most=2)]
AsJson = Annotated[bool, Option("Print JSON instead of text.", flags="--json")]
Compile = Annotated[
    bool, Option("Build FMUs without a binary for this machine from their sources, once.", flags="--compile")
]
DriveName = Annotated[
    str | None, Option("Drive of every joint: an .fmu file, or a drive of fmus/.", "FMU", "--drive", complete="drive")
]
BodyName = Annotated[
    str | None,
    Option("Body to press on: a file of experiments/bodies/, such as back.", "BODY", "--body", complete="body"),
]
Settings = Annotated[
    Sequence[str],
    Option(
        "Override a value of the experiment, such as controller.force.reference_N=4, or task.1.force_N=5 (first task).",
        "KEY=VALUE",
        "--set",
        complete="setting",
    ),
]
ColumnMaps = Annotated[
    Sequence[str], Option("Column of a signal; or a TOML file of such.", "NAME=COLUMN[UNIT]", "--map")
]
FromS = Annotated[float | None, Option("Start of the part of the log to use, in s.", "S")]
ToS = Annotated[float | None, Option("End of the part of the log to use, in s.", "S")]
LivePort = Annotated[int, Option("With --live: port; 0: any free one.", "N", flags="--port", least=0, most=65535)]
LiveOrigins = Annotated[
    Sequence[str],
    Option("With --live: also allow pages from this origin, https://host:port.", "ORIGIN", "--origin"),
]
Page = Annotated[bool, Option("Also write an HTML page, like twin report.", flags="--report")]
ExperimentName = Annotated[Path, Argument("Experiment file (TOML) or name.", "EXPERIMENT", complete="experiment")]

SHARED_OPTIONS: Mapping[str, tuple[Any, Any]] = {
    "formats": (Formats, ()),
    "columns": (Columns, 2),
    "as_json": (AsJson, False),
    "report": (Page, False),
    "isolate": (Isolate, JOB_ISOLATION),
    "limit_step": (LimitStep, JobLimits.step),
    "limit_wall": (LimitWall, math.inf),
}
"""Shared options: argument name -> (annotated type, default)."""


def run_isolated(
    name: str,
    asked: ArgumentValues,
    say: "Say",
    isolate: JobIsolation = "none",
    limits: JobLimits = JobLimits(),  # noqa: B008, it is frozen
    formats: Sequence[str] = (),
    columns: int = 2,
) -> "Answer":
    """Run a study, in a separate process or in this one, and return its answer.

    Args:
        name: "module:function", see `answer_study`.
        isolate: "run" for a separate process, else this one; a study without FMUs needs no isolation.
        formats, columns: file formats and width of pictures for a paper, in addition to the screen pictures.

    Raises:
        ComponentFailed: an FMU crashed, hung or ended the process.
    """

    def hear(note: dict[str, Any]) -> None:
        say(note["say"], note["share"])

    arguments: dict[str, Any] = {"study": name, "asked": dict(asked), "formats": list(formats), "columns": columns}
    if isolate == "none":
        from twin.kernel.process.exits import EXIT_MESSAGE, report_exit
        from twin.kernel.process.reporter import DirectReporter

        with report_exit(lambda: EXIT_MESSAGE):
            return Answer(**answer_study(DirectReporter(hear), **arguments))
    from twin.kernel.process.guard import JobFailure, JobLoadFailure, run_guarded

    try:
        return Answer(**run_guarded(ANSWER_JOB, arguments, limits, hear))
    except (JobFailure, JobLoadFailure) as failure:
        raise ComponentFailed(str(failure)) from None


def answer_recording(reporter: "Reporter", name: str, asked: ArgumentValues) -> dict[str, Any]:
    """Call the study `name` ("module:function") with `reporter` in a guarded process; return its `Answer`'s fields.

    Notes before the run, in addition to the study's: {"experiment": name, "folder": its folder, "duration" (s)}.
    """
    return vars(answer_of(load_function(name)(**asked, reporter=reporter)))


def confirm(question: str) -> bool:
    import click

    return click.confirm(question, err=True)


class Say(Protocol):
    """Progress callback of a study: called with activity and completed share, 0 .. 1 (None if unknown)."""

    def __call__(self, what: str, share: float | None = None, /) -> None: ...


def ignore_progress(what: str, share: float | None = None, /) -> None:
    """Ignore a study's progress report."""


class Steps:
    """Progress counter of a study with steps of about equal duration."""

    def __init__(self, say: Say, total: int):
        self._say, self._total, self._begun = say, total, 0

    def next(self, what: str) -> None:
        """Complete the current step of a study and report the beginning of step `what`."""
        self._say(f"{what}, {self._begun + 1} of {self._total}", min(1.0, self._begun / self._total))
        self._begun += 1

    def share(self, what: str, done: float) -> None:
        """Report that a share (0 .. 1) of the study's current step is complete."""
        self._say(what, min(1.0, (max(0, self._begun - 1) + done) / self._total))


@dataclass(frozen=True)
class Answer:
    """The answer of a study: text of at most 80 columns, facts for JSON, exit code (1 and more: a result failed)."""

    text: str
    facts: Any
    exit_code: int = 0


def write_verdict(
    name: str, folder: Path, result: Result, draw: Callable[[Path], None], notes: Sequence[str] = ()
) -> Result:
    """Write picture and verdict of a comparison to `folder`; return the result with these files and `notes`."""
    files = {"picture": make_folder(folder) / f"{name}.png", "verdict": folder / f"{name}.json"}
    draw(files["picture"])
    write_json(files["verdict"], result.facts)
    return replace(result, body=[*result.body, *(f"  note     {note}" for note in notes)], files=files, label=8)


def answer_study(
    reporter: "Reporter", study: str, asked: dict[str, Any], formats: Sequence[str] = (), columns: int = 2
) -> dict[str, Any]:
    """Run a study in a guarded process and return the fields of its `Answer`.

    Notes: {"say": current activity, "share": completed share or None}.

    Args:
        study: "module:function"; the function is called with the arguments in `asked` and `say`.
        formats, columns: file formats and width of pictures for a paper, see `for_paper`.
    """

    def say(what: str, share: float | None = None, /) -> None:
        reporter.note(say=what, share=share)

    if not formats:
        return vars(answer_of(load_function(study)(**asked, say=say)))
    # Most answers draw nothing, and importing matplotlib is slow.
    from twin.studies.figure import for_paper

    with for_paper(formats, columns) as paper:
        answer = answer_of(load_function(study)(**asked, say=say))
    files = [str(path) for path in paper.written]
    lines = [answer.text, *(f"  {Path(file).suffix[1:]:<8} {file}" for file in files)]
    return vars(replace(answer, text="\n".join(lines), facts=answer.facts | {"pictures": files}))


def answer_of(found: Result | Answer) -> Answer:
    """Convert a study's return value to an `Answer`; a `Result` is rendered to text and JSON."""
    return found if isinstance(found, Answer) else Answer(render_text(found), to_json(found), found.exit_code)
