"""`twin sweep`: many runs of one experiment."""

import os
import shlex
import sys
from collections.abc import Callable
from dataclasses import dataclass
from enum import StrEnum
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

import typer

from twin.cli.group import Group
from twin.cli.options import AsJson, LimitStep
from twin.cli.sweep_show import By, as_facts, show
from twin.cli.terminal import Progress, progress
from twin.errors import InputRefused
from twin.runs.guard.limits import cores
from twin.writing import json_text

if TYPE_CHECKING:
    from twin.runs.guard.limits import JobLimits
    from twin.studies.sweep.definition import Definition
    from twin.studies.sweep.folder import KeptRows
    from twin.studies.sweep.plan import Plan
    from twin.studies.sweep.pool import Engine

MANY = 100_000
"""Runs from which on nobody starts without having been asked."""
RUN = "run"


class Sweeps(Group):
    """`twin sweep FILE` means `twin sweep run FILE`."""

    def parse_args(self, ctx: Any, args: list[str]) -> list[str]:
        own = not args or args[0] in self.commands or args[0] == "--help" or args[0].startswith("--show-completion")
        return super().parse_args(ctx, args if own else [RUN, *args])


class EngineName(StrEnum):
    """Who runs the runs."""

    LOCAL = "local"
    DASK = "dask"


class Record(StrEnum):
    """Which runs leave a recording."""

    NONE = "none"
    FAILURES = "failures"
    ALL = "all"


app = typer.Typer(cls=Sweeps)

Sweep = Annotated[Path, typer.Argument(metavar="SWEEP", help="A sweep file (TOML), or its name: stiffness_and_gain.")]


@app.callback()
def sweep() -> None:
    """Run one experiment many times: twin sweep SWEEP, or twin sweep run SWEEP."""


@app.command(RUN)
def run(
    sweep: Sweep,
    out: Annotated[
        Path | None, typer.Option(metavar="DIR", help="The sweep's folder; without it, results/sweeps/NAME.")
    ] = None,
    dry: Annotated[
        bool, typer.Option("--dry-run", help="Only count the runs, and estimate time and disk by running one.")
    ] = False,
    processes: Annotated[
        int | None,
        typer.Option(
            "-j", "--processes", min=1, metavar="N", help="Processes; without it, as many as there are cores."
        ),
    ] = None,
    record: Annotated[Record, typer.Option(help="Full recordings of which runs.")] = Record.NONE,
    limit_step: LimitStep = 10.0,
    parquet: Annotated[bool, typer.Option("--parquet", help="In the end, write rows.parquet, too.")] = False,
    yes: Annotated[bool, typer.Option("--yes", help=f"Do not ask before {MANY:,} runs, or runs of an hour.")] = False,
    engine: Annotated[
        EngineName, typer.Option(help="Who runs them: processes here, or the workers of a Dask cluster.")
    ] = EngineName.LOCAL,
    scheduler: Annotated[
        str | None,
        typer.Option(metavar="ADDRESS", help="Of a running Dask cluster; without it, one is started here."),
    ] = None,
    by: By = None,
    as_json: AsJson = False,
) -> None:
    """Run the runs of a sweep that have no row yet, in several processes.

    A run that fails, crashes or hangs is a row with a reason and costs only
    itself. The same command goes on after an interruption.
    Exit code: 0 every run has a row, 1 none of them has metrics, 2 input refused,
    3 the disk is full or the cluster is gone, 130 interrupted.

    Example: twin sweep run experiments/sweeps/stiffness_and_gain.toml --dry-run
    """
    from twin.experiment.drive_files import sweep_file
    from twin.studies.sweep.definition import read_definition
    from twin.studies.sweep.folder import HOME
    from twin.studies.sweep.plan import planned

    sweep = sweep_file(sweep)
    definition, _ = read_definition(sweep)
    check_start(str(sweep), definition, yes or dry)
    folder = out or HOME / sweep.stem
    if scheduler and engine != EngineName.DASK:
        raise InputRefused(f"--scheduler {scheduler}: belongs to --engine dask; add that, or leave the address out")
    if scheduler and processes:
        raise InputRefused(f"--processes {processes}: the cluster of {scheduler} has the workers it has; leave it out")
    how = How(
        folder, processes or cores(), record.value, limit_step, dry, parquet, by, as_json, yes, engine.value, scheduler
    )
    carry_out(lambda: planned(sweep), how)


@dataclass(frozen=True)
class How:
    """The options of a sweep, by the names that `run` has for them."""

    out: Path
    processes: int
    record: str
    limit_step: float
    dry: bool
    parquet: bool
    by: str | None
    as_json: bool
    sure: bool = False
    engine: str = "local"
    scheduler: str | None = None


def check_start(place: str, definition: "Definition", sure: bool) -> None:
    """Ask whoever starts a sweep of many runs, unless they are `sure`.

    Raises:
        InputRefused: sweeps do not run on this system, or nobody says that so many runs are meant.
    """
    from twin.studies.sweep.plan import largest_count

    if os.name != "posix":
        raise InputRefused("twin sweep: needs Linux or macOS, where a drive that crashes can be kept apart")
    count = largest_count(definition)
    if count < MANY or sure:
        return
    question = f"{place}: makes up to {count:,} runs"
    if not sys.stdin.isatty():
        raise InputRefused(f"{question}; say --yes if that is meant, --dry-run shows what it takes")
    if not typer.confirm(f"{question}. Go on?", err=True):
        raise InputRefused(f"{question}; nothing was run")


def carry_out(plan_made: Callable[[], "Plan"], how: How) -> None:
    """Run the plan, or estimate what it takes, and say what it came to."""
    from twin.runs.guard.limits import JobLimits
    from twin.studies.sweep.folder import kept
    from twin.studies.sweep.statistics.ranking import checked_rank
    from twin.studies.sweep.sweep import run_sweep, state_text

    limits, line = JobLimits(step=how.limit_step), progress()
    line.say("making the runs")
    try:
        plan = plan_made()
        if how.by:
            checked_rank("--by", how.by, plan.metrics)
        if not how.sure:
            _refuse_endless(plan)
        if how.dry:
            _estimate(plan, how, limits, line)
            return
        run_sweep(plan, how.out, _engine(how), how.record, limits, lambda state: line.say(state_text(state)))
    except KeyboardInterrupt:
        from twin.studies.sweep.rows import ROWS

        line.clear()
        if how.dry or not (how.out / ROWS).exists():
            raise
        found = kept(how.out)
        print(
            f"interrupted; {len(found.columns)} of {found.runs} runs are kept in {how.out}; "
            "the same command runs the others",
            file=sys.stderr,
        )
        raise SystemExit(130) from None
    finally:
        line.clear()
    found = kept(how.out)
    if how.parquet:
        from twin.studies.sweep.folder import write_parquet

        write_parquet(found, how.out / "rows.parquet")
    _tell(found, how.out, how.by, how.as_json)
    if True not in found.columns.words("has_metrics").counts:
        raise SystemExit(1)


app.command("show")(show)


def _refuse_endless(plan: "Plan") -> None:
    """Ask whoever starts a sweep whose runs take hours each; also the estimate makes two of them."""
    from twin.runs.assembly.load import load_experiment
    from twin.runs.guard.limits import LONG
    from twin.runs.watch import estimate

    first = plan.tasks[0]
    seconds, _ = estimate(load_experiment(plan.experiment, first.settings, first.drive))
    if seconds > LONG:
        raise InputRefused(
            f"{plan.name}: each run takes about {seconds / 3600.0:.2g} hours; shorten duration_s, or say --yes if that "
            "is meant"
        )


def _engine(how: How) -> "Engine":
    if how.engine == "local":
        from twin.studies.sweep.pool import Pool

        return Pool(how.processes)
    from twin.studies.sweep.dask.engine import Dask

    return Dask(how.scheduler, how.processes)


def _estimate(plan: "Plan", how: How, limits: "JobLimits", line: Progress) -> None:
    from twin.studies.sweep.sweep import estimate_text, estimated

    line.say("trying the first one")
    estimate, first = estimated(plan, how.record, limits)
    line.clear()
    runs = len(plan.tasks)
    seconds, size = estimate.total(runs, how.processes)
    facts = {"runs": runs, "processes": how.processes, "seconds": seconds, "MB": size / 1e6, "first": first}
    print(json_text(facts) if how.as_json else estimate_text(plan.name, runs, how.processes, estimate, first))


def _tell(found: "KeptRows", folder: Path, by: str | None, as_json: bool) -> None:
    from twin.studies.sweep.rows import ROWS
    from twin.studies.sweep.show.parts import headline_text
    from twin.studies.sweep.statistics import usual_metric

    if as_json:
        print(json_text(as_facts(found)))
        return
    answer = headline_text(found, by or usual_metric(found.columns))
    print(f"{answer}\n  rows  {folder / ROWS}\n  next  {shlex.join(['twin', 'sweep', 'show', str(folder)])}")
