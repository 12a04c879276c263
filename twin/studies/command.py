"""A study as a command: one function, whose arguments are those of the command line.

The command's name is the function's, its help is the docstring up to `Raises:`. A module holds it if it is
`twin/studies/NAME.py` or `twin/studies/NAME/study.py`: nothing else says that there is such a command. The command line
reads the arguments without running anything, so such a module imports at its top only what they need, and what computes
inside the function.
"""

import os
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from enum import StrEnum
from pathlib import Path
from typing import Annotated, Any, TypeVar

Function = TypeVar("Function", bound=Callable[..., Any])
Asked = Mapping[str, Any]
"""Values of a study's arguments, by name."""


@dataclass(frozen=True)
class Option:
    """What a command line says of an argument; an optional one, named `--like-this` after it.

    Attributes:
        help: one sentence.
        metavar: stands for the value.
        flags: other names: "--overshoot-percent", "-j --processes", "--try/--no-try".
        least, most: bounds of a number.
        complete: what the shell offers: "experiment", "drive", "body", "setting" or "role".
    """

    help: str
    metavar: str | None = None
    flags: str = ""
    least: float | None = None
    most: float | None = None
    complete: str = ""


@dataclass(frozen=True)
class Argument(Option):
    """One that is given by its place."""


@dataclass(frozen=True)
class Study:
    """How a function is asked from the command line.

    Attributes:
        draws: whether it draws pictures, which `--format` and `--columns` are of.
        isolated: whether it steps FMUs, so that it runs in a process of its own unless `--isolate none` is given.
        before: called with what is asked before the study's process begins: slips are refused at once.
        on_failure: what is added to the message if a component fails, such as where results are until then.
    """

    draws: bool
    isolated: bool
    before: Sequence[Callable[[Asked], None]]
    on_failure: Callable[[Asked], str] | None


def study(
    *,
    draws: bool = False,
    isolated: bool = False,
    before: Sequence[Callable[[Asked], None]] = (),
    on_failure: Callable[[Asked], str] | None = None,
) -> Callable[[Function], Function]:
    """Mark a function as a study; it stays what it is for who calls it from Python.

    It takes `say`, see `Say`, beside its options, and returns an `Answer`. Options that all studies have, such as
    `--json`, are added. Arguments: see `Study`.
    """

    def mark(function: Function) -> Function:
        vars(function)["study"] = Study(draws, isolated, before, on_failure)
        return function

    return mark


class JobIsolation(StrEnum):
    """What lives in a process of its own."""

    RUN = "run"
    NONE = "none"


JOB_ISOLATION = JobIsolation.RUN if os.name == "posix" else JobIsolation.NONE
"""Where processes can be guarded they are, unless one says no."""
ISOLATE = Option("Processes: one of its own for what steps FMUs; none, for debuggers, but this one.", flags="--isolate")
DRIVE = Option("Drive of every joint: an .fmu file, or a drive of fmus/.", "FMU", "--drive", complete="drive")
BODY = Option("What to press on: a file of experiments/bodies/, such as back.", "BODY", "--body", complete="body")
SETTING = Option(
    "Override a value of the experiment, such as controller.force_N=4; of its first task: task.1.force_N=5.",
    "KEY=VALUE",
    "--set",
    complete="setting",
)
COLUMN_MAP = Option("Which column is what; or a TOML file of such.", "NAME=COLUMN[UNIT]", "--map")

Isolate = Annotated[JobIsolation, ISOLATE]
DriveName = Annotated[str | None, DRIVE]
BodyName = Annotated[str | None, BODY]
Settings = Annotated[Sequence[str], SETTING]
ColumnMaps = Annotated[Sequence[str], COLUMN_MAP]
ExperimentName = Annotated[Path, Argument("Experiment file (TOML) or name.", "EXPERIMENT", complete="experiment")]
