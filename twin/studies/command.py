"""The decorator that makes a command of a study: one function, whose arguments are those of the command line.

The command's name is the function's, or the words that the decorator is given (`@study("drive check")`); its help is
the docstring up to `Raises:`. A module holds it if it is `twin/studies/NAME.py` or `twin/studies/NAME/study.py`, or one
of the command line itself: nothing else says that there is such a command. The arguments are read without running
anything, so such a module imports at its top only what they need, and what computes inside the function.

Besides: progress of a study while it runs; its answer, the same for every study.
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
"""Values of a study's arguments, by name."""


@dataclass(frozen=True)
class Option:
    """An option of a command, named `--like-this` after its argument.

    Attributes:
        help: one sentence.
        metavar: stands for the value.
        flags: other names: "--overshoot-percent", "-j --processes", "--try/--no-try".
        least, most: bounds of a number.
        complete: what the shell offers: "experiment", "experiment name", "drive", "body", "setting" or "role".
    """

    help: str
    metavar: str | None = None
    flags: str = ""
    least: float | None = None
    most: float | None = None
    complete: str = ""


@dataclass(frozen=True)
class Argument(Option):
    """A positional argument of a command."""


@dataclass(frozen=True)
class Study:
    """Marks a function as a study, as `@study(...)`; it stays what it is for who calls it from Python.

    An argument whose type is a dataclass, such as `MasterOptions`, stands for its fields: each is an option. Beside its
    options it takes `say`, see `Say`; or `reporter`, see `Reporter`, if it records a run; or neither, if there is
    nothing to wait for. It returns an `Answer`, yields one after the other as it has them, or prints for itself.
    Options that studies share, such as `--json`, are added; one that needs to know such an option has it among its
    arguments.

    Attributes:
        words: of the command, if they are not the function's name.
        draws: whether it draws pictures, which `--format` and `--columns` are of.
        isolated: whether it steps FMUs, so that it runs in a process of its own unless `--isolate none` is given; or
            the name of the flag without which it steps none.
        limited: whether `--limit-step` and `--limit-wall` are of that process.
        json: whether there is `--json`.
        reported: whether the fact `recording` of its answer is one, of which `--report` writes a page.
        before: called with what is asked before the study's process begins: slips are refused at once. What one
            returns is added to the answer's facts.
        on_failure: what is added to the message if a component fails, such as where results are until then.
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
        """Those of `SHARED_OPTIONS` that it has."""
        process = [*(["isolate"] if self.isolated else []), *(["limit_step", "limit_wall"] if self.limited else [])]
        page = ["report"] if self.reported else []
        return [*(["formats", "columns"] if self.draws else []), *(["as_json"] if self.json else []), *page, *process]


study = Study


def options_of(record: type[Record], asked: ArgumentValues) -> Record:
    """Return a record of options, from what is asked by their names; what is not asked has its default."""
    return record(**{one.name: asked[one.name] for one in fields(record) if one.name in asked})  # type: ignore[arg-type]


def _with_own_options(function: Function) -> Function:
    """Return `function` with the fields of its records of options as arguments of its own."""
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
    """Ctrl-C; says what is kept."""

    exit_code = INTERRUPT_EXIT_CODE


JobIsolation = Literal["run", "none"]
"""What lives in a process of its own."""
JOB_ISOLATION: JobIsolation = "run" if os.name == "posix" else "none"
"""Where processes can be guarded they are, unless one says no."""
Isolation = Literal["run", "drive", "none"]
"""The same of a run, whose drives may have processes of their own."""


PictureFormat = Literal["svg", "pdf"]
"""What pictures are written as for a paper."""

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
DEFAULT_PORT = 8765
"""Where `--live` serves; viewers propose it, too."""
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
"""Options that studies share, by the names of arguments: what they are, and their defaults."""


def run_isolated(
    name: str,
    asked: ArgumentValues,
    say: "Say",
    isolate: JobIsolation = "none",
    limits: JobLimits = JobLimits(),  # noqa: B008, it is frozen
    formats: Sequence[str] = (),
    columns: int = 2,
) -> "Answer":
    """What a study answers.

    Args:
        name: "module:function", see `answer_study`.
        isolate: what gets a process of its own; a study that steps no FMU needs none.
        formats, columns: of pictures for a paper, besides those for the screen.

    Raises:
        ComponentFailed: an FMU crashed, hung or ended that process. With nothing recorded to lose it is no matter
            whether stepping had begun.
        TwinError: the study raised one.
    """

    def hear(note: dict[str, Any]) -> None:
        say(note["say"], note["share"])

    arguments: dict[str, Any] = {"study": name, "asked": dict(asked), "formats": list(formats), "columns": columns}
    if isolate == "none":
        from twin.kernel.process.reporter import DirectReporter

        return Answer(**answer_study(DirectReporter(hear), **arguments))
    from twin.kernel.process.guard import JobFailure, JobLoadFailure, run_guarded

    try:
        return Answer(**run_guarded(ANSWER_JOB, arguments, limits, hear))
    except (JobFailure, JobLoadFailure) as failure:
        raise ComponentFailed(str(failure)) from None


def answer_recording(reporter: "Reporter", name: str, asked: ArgumentValues) -> dict[str, Any]:
    """What a study answers that records a run, taken apart; a job of the guard.

    Notes, besides those of the study: {"experiment": what is run, "folder": of the run, "duration" (s)} before it.

    Args:
        name: "module:function"; the function takes what is asked, and `reporter`.
    """
    return vars(answer_of(load_function(name)(**asked, reporter=reporter)))


def confirm(question: str) -> bool:
    """Whether who sits at the terminal says yes."""
    import click

    return click.confirm(question, err=True)


class Say(Protocol):
    """Takes what is being done, and how much of all is over, 0 .. 1; None: unknown."""

    def __call__(self, what: str, share: float | None = None, /) -> None: ...


def ignore_progress(what: str, share: float | None = None, /) -> None:
    """Where progress is not asked for."""


class Steps:
    """Counts steps that take about as long as each other."""

    def __init__(self, say: Say, total: int):
        self._say, self._total, self._begun = say, total, 0

    def next(self, what: str) -> None:
        """The one before is over, and `what` begins."""
        self._say(f"{what}, {self._begun + 1} of {self._total}", min(1.0, self._begun / self._total))
        self._begun += 1

    def share(self, what: str, done: float) -> None:
        """So much of the present step, 0 .. 1, is over."""
        self._say(what, min(1.0, (max(0, self._begun - 1) + done) / self._total))


ANSWER_JOB = "twin.studies.command:answer_study"


@dataclass(frozen=True)
class Answer:
    """The answer of a study to its command.

    Attributes:
        text: for people, at most 80 columns.
        facts: for programs; JSON can hold them.
        exit_code: of a command that asks this; 0 or, of what was judged, 1 and more if it failed.
    """

    text: str
    facts: Any
    exit_code: int = 0


def write_verdict(
    name: str, folder: Path, result: Result, draw: Callable[[Path], None], notes: Sequence[str] = ()
) -> Result:
    """`result` of a comparison with notes and with where its files are; picture and verdict are written."""
    files = {"picture": make_folder(folder) / f"{name}.png", "verdict": folder / f"{name}.json"}
    draw(files["picture"])
    write_json(files["verdict"], result.facts)
    return replace(result, body=[*result.body, *(f"  note     {note}" for note in notes)], files=files, label=8)


def answer_study(
    reporter: "Reporter", study: str, asked: dict[str, Any], formats: Sequence[str] = (), columns: int = 2
) -> dict[str, Any]:
    """The answer of a study, taken apart; a job of the guard.

    Notes {"say": what is being done, "share": of all that is over, or None}.

    Args:
        study: "module:function"; the function takes what is asked, and `say`, which it tells what it is doing, and
            returns a `Result` or an `Answer`.
        formats, columns: of pictures for a paper, see `for_paper`.
    """

    def say(what: str, share: float | None = None, /) -> None:
        reporter.note(say=what, share=share)

    if not formats:
        return vars(answer_of(load_function(study)(**asked, say=say)))
    # most answers draw nothing, and it takes a while to load
    from twin.studies.figure import for_paper

    with for_paper(formats, columns) as paper:
        answer = answer_of(load_function(study)(**asked, say=say))
    files = [str(path) for path in paper.written]
    lines = [answer.text, *(f"  {Path(file).suffix[1:]:<8} {file}" for file in files)]
    return vars(replace(answer, text="\n".join(lines), facts=answer.facts | {"pictures": files}))


def answer_of(found: Result | Answer) -> Answer:
    """What is printed of a study's result; an answer is one already."""
    return found if isinstance(found, Answer) else Answer(render_text(found), to_json(found), found.exit_code)
