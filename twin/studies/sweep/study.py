"""`twin sweep run`: run the runs of a sweep that have no row yet."""

import os
import shlex
import sys
from collections.abc import Iterator, Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any, Literal

from twin.kernel.errors import InputRefused
from twin.kernel.process.job import LONG_RUN_DURATION, JobLimits, core_count
from twin.studies.command import Answer, Argument, AsJson, LimitStep, Option, Say, StudyInterrupt, confirm, study

if TYPE_CHECKING:
    from twin.studies.sweep.engine import Engine
    from twin.studies.sweep.plan import SweepFile, SweepPlan
    from twin.studies.sweep.stored import SweepRows

MAX_UNASKED_RUNS = 100_000
"""Threshold number of runs above which a sweep asks for confirmation."""


EngineName = Literal["local", "dask"]
Record = Literal["none", "failures", "all"]
By = Annotated[str | None, Option("Metric to rank by; without it, the hold error.", "METRIC", "--by")]


@study("sweep run")
def sweep_run(
    sweep: Annotated[Path, Argument("A sweep file (TOML), or its name: stiffness_and_gain.", "SWEEP")],
    say: Say,
    out: Annotated[Path | None, Option("Folder of the sweep; default: results/sweeps/NAME.", "DIR")] = None,
    dry: Annotated[
        bool, Option("Only count the runs and estimate time and disk space from one run.", flags="--dry-run")
    ] = False,
    processes: Annotated[
        int | None, Option("Number of parallel processes; default: number of cores.", "N", "-j --processes", least=1)
    ] = None,
    record: Annotated[Record, Option("Runs that are recorded in full.")] = "none",
    limit_step: LimitStep = JobLimits.step,
    parquet: Annotated[bool, Option("Also write rows.parquet at the end.")] = False,
    yes: Annotated[bool, Option(f"Do not ask before {MAX_UNASKED_RUNS:,} runs, or runs of an hour.")] = False,
    engine: Annotated[EngineName, Option("Local processes, or the workers of a Dask cluster.")] = "local",
    scheduler: Annotated[str | None, Option("With --engine dask: address of its scheduler.", "ADDRESS")] = None,
    by: By = None,
    as_json: AsJson = False,
) -> Iterator[Answer]:
    """Run the runs of a sweep that have no row yet, in several processes.

    A run that fails, crashes or hangs becomes a row with a reason; the others
    continue. After an interruption, give the same command again to continue.

    Exit code: 0 every run has a row, 1 no run has metrics, 2 input refused,
    3 the disk is full or the cluster is gone, 130 interrupted.

    Example: twin sweep run experiments/sweeps/stiffness_and_gain.toml --dry-run
    """
    from twin.robot.experiment.experiment_files import sweep_file
    from twin.studies.sweep.plan import read_definition, read_plan
    from twin.studies.sweep.stored import SWEEPS_FOLDER

    sweep = sweep_file(sweep)
    definition, _ = read_definition(sweep)
    check_start(str(sweep), definition, yes or dry)
    if engine == "dask" and not scheduler:
        raise InputRefused(
            "--engine dask: no longer starts a cluster; add --scheduler ADDRESS, the address that dask scheduler "
            "prints, or leave --engine out"
        )
    if scheduler and engine != "dask":
        raise InputRefused(f"--scheduler {scheduler}: belongs to --engine dask; add that, or leave the address out")
    if scheduler and processes:
        raise InputRefused(f"--processes {processes}: the cluster of {scheduler} has the workers it has; leave it out")
    folder, processes = out or SWEEPS_FOLDER / sweep.stem, processes or core_count()
    limits = JobLimits(step=limit_step)
    say("making the runs")
    plan = _check_plan(read_plan(sweep), by, yes)
    if dry:
        yield _estimate_answer(plan, record, processes, limits, say)
        return
    yield complete_sweep(plan, folder, _engine(scheduler, processes), limits, say, record, parquet, by, as_json)


def short_sweep(
    experiment: Path,
    ranges: Sequence[str],
    drive: str | None,
    settings: Sequence[str],
    out: Path | None,
    limit_step: float,
    as_json: bool,
    yes: bool,
    say: Say,
) -> Answer:
    """Run the grid sweep that the option --sweep of `twin run` describes."""
    from twin.robot.experiment.experiment_files import experiment_file
    from twin.studies.sweep.plan import plan_of, short_definition
    from twin.studies.sweep.stored import SWEEPS_FOLDER

    experiment = experiment_file(experiment)
    definition = short_definition(experiment, ranges, drive)
    place = f"--sweep {' '.join(ranges)}"
    check_start(place, definition, yes)
    say("making the runs")
    plan = plan_of(definition, experiment, experiment.stem, place, settings)
    # Other ranges make another sweep; the same command continues its own.
    folder = out or SWEEPS_FOLDER / f"{plan.name}-{plan.configuration['the sweep'][:8]}"
    engine, limits = _engine(None, core_count()), JobLimits(step=limit_step)
    return complete_sweep(_check_plan(plan, None, yes), folder, engine, limits, say, as_json=as_json)


def check_start(place: str, definition: "SweepFile", sure: bool) -> None:
    """Ask for confirmation before a sweep of many runs, unless it is confirmed already."""
    from twin.studies.sweep.plan import largest_count

    if os.name != "posix":
        raise InputRefused("twin sweep: needs Linux or macOS, where a drive that crashes can be kept apart")
    count = largest_count(definition)
    if count < MAX_UNASKED_RUNS or sure:
        return
    question = f"{place}: makes up to {count:,} runs"
    if not sys.stdin.isatty():
        raise InputRefused(f"{question}; add --yes if that is intended, --dry-run estimates the cost")
    if not confirm(f"{question}. Continue?"):
        raise InputRefused(f"{question}; nothing was run")


def _check_plan(plan: "SweepPlan", by: str | None, sure: bool) -> "SweepPlan":
    """Check the metric of a sweep's plan and, unless confirmed, the duration of a run; return the plan."""
    from twin.studies.sweep.statistics.ranking import require_rank

    if by:
        require_rank("--by", by, plan.metrics)
    if sure:
        return plan
    from twin.robot.assembly.load import load_experiment
    from twin.robot.run.cost import estimate

    first = plan.tasks[0]
    seconds, _ = estimate(load_experiment(plan.experiment, first.settings, first.drive))
    if seconds > LONG_RUN_DURATION:
        raise InputRefused(
            f"{plan.name}: each run takes about {seconds / 3600.0:.2g} hours; shorten duration_s, or add --yes if that "
            "is intended"
        )
    return plan


def _engine(scheduler: str | None, processes: int) -> "Engine":
    if scheduler is None:
        from twin.studies.sweep.engine import LocalEngine

        return LocalEngine(processes)
    try:
        from twin.studies.sweep.dask.engine import DaskEngine
    except ModuleNotFoundError:
        raise InputRefused(
            "--engine dask: needs dask.distributed; install it with pip install 'dask>=2024.8' 'distributed>=2024.8'"
        ) from None
    return DaskEngine(scheduler)


def _estimate_answer(plan: "SweepPlan", record: Record, processes: int, limits: JobLimits, say: Say) -> Answer:
    from twin.studies.sweep.sweep import estimate_text, measure_cost

    say("trying the first one")
    estimate, first = measure_cost(plan, record, limits)
    runs = len(plan.tasks)
    seconds, size = estimate.total(runs, processes)
    facts = {"runs": runs, "processes": processes, "seconds": seconds, "MB": size / 1e6, "first": first}
    return Answer(estimate_text(plan.name, runs, processes, estimate, first), facts)


def complete_sweep(
    plan: "SweepPlan",
    folder: Path,
    engine: "Engine",
    limits: JobLimits,
    say: Say,
    record: Record = "none",
    parquet: bool = False,
    by: str | None = None,
    as_json: bool = False,
) -> Answer:
    """Make the runs of a sweep that have no row yet, and return the answer on all rows.

    The answer has facts, possibly many rows, only with `as_json`. Exit code 1: no run has metrics.
    """
    from twin.studies.sweep.engine import LocalEngine
    from twin.studies.sweep.parquet import write_parquet
    from twin.studies.sweep.rows import ROWS_FILE
    from twin.studies.sweep.show.parts import headline_text
    from twin.studies.sweep.statistics.ranking import usual_metric
    from twin.studies.sweep.stored import stored_sweep
    from twin.studies.sweep.sweep import run_sweep, state_text

    try:
        run_sweep(plan, folder, engine, record, limits, lambda state: say(state_text(state)))
    except KeyboardInterrupt:
        if not (folder / ROWS_FILE).exists():
            raise
        found = stored_sweep(folder)
        raise StudyInterrupt(
            f"interrupted; {len(found.columns)} of {found.runs} runs are kept in {folder}; "
            "the same command runs the others"
        ) from None
    found = stored_sweep(folder)
    if isinstance(engine, LocalEngine):
        # Importing the linearisation takes a second.
        from twin.studies.sweep.margins import write_margins

        write_margins(plan, found, folder, engine, limits, say)
    if parquet:
        write_parquet(found, folder / "rows.parquet")
    code = 0 if True in found.columns.categorical("has_metrics").counts else 1
    if as_json:
        return Answer("", rows_to_dict(found), code)
    text = headline_text(found, by or usual_metric(found.columns))
    next_ = shlex.join(["twin", "sweep", "show", str(folder)])
    return Answer(f"{text}\n  rows  {folder / ROWS_FILE}\n  next  {next_}", {}, code)


def rows_to_dict(found: "SweepRows") -> dict[str, Any]:
    rows = [{key: value for key, value in row.items() if key != "curves"} for row in found.rows]
    return {"sweep": found.name, "runs": found.runs, "limits": found.limits, "rows": rows}
