"""The job of a worker process: the runs of a sweep, one after the other."""

import contextlib
import functools
import gc
import os
import shutil
import time
from collections.abc import Sequence
from pathlib import Path
from typing import Any

from twin.kernel.atomic_write import make_folder
from twin.kernel.errors import ComponentFailed, InputRefused
from twin.kernel.process.job import load_function
from twin.kernel.process.reporter import Reporter
from twin.robot.assembly.load import load_experiment
from twin.robot.experiment.experiment import Experiment
from twin.robot.mechanism.geometry import geometry_of
from twin.robot.run.run import execute
from twin.robot.run.runs import Outcome, RunRequest, Runs
from twin.studies.check.measurement import Signals, metrics_of_measure, refuse_unknown
from twin.studies.paper.fig4_measures import Fig4Run, Fig4Runs
from twin.studies.sweep.claims import COMPANION_SETTING, findings
from twin.studies.sweep.measures import metrics_of, run_fields
from twin.studies.sweep.plan import files_digest, text_settings

RUNS_BEFORE_SHARING = 2
"""Runs of one prefix made from the start; the shared prefix takes about as long as two runs."""
NUMBERS_REQUEST, SIGNALS_REQUEST = RunRequest(tally=True), RunRequest(signals=None, tally=True, check=refuse_unknown)

_runs = Runs(NUMBERS_REQUEST, RUNS_BEFORE_SHARING, most=1)
"""Runs of this process; runs whose keys act from the start share no prefix."""


def run_task(
    reporter: Reporter,
    here: str,
    experiment: str,
    folder: str,
    claims: str,
    trial: str,
    drive: str | None,
    settings: Sequence[str],
    record: str,
    files: str,
) -> dict[str, Any]:
    """Make one run of a sweep in a worker process and return the fields of its row.

    A recorded run is made twice: measuring must not depend on the recorder, and the good runs of a sweep that records
    failures never use it. The arguments are `Job.arguments`: the working directory because an FMU may have changed it,
    `files` to refuse a run that would read other files.
    """
    reporter.loading()
    os.chdir(here)
    what, own = (Path(experiment), drive, settings), Path(folder)
    if files and files_here(Path(experiment), drive, text_settings(settings)) != files:
        raise InputRefused(f"{experiment}: reads other files here than where the sweep was started; install the same")
    if record != "none":
        # Remove files of an interrupted attempt.
        shutil.rmtree(own, ignore_errors=True)
    judge = load_function(trial)
    if record == "all":
        record_run(*what, own)
        reporter.loading()
    facts: dict[str, Any] = judge(*what, claims)
    if record == "failures" and facts["status"] != "done":
        reporter.loading()
        record_run(*what, own)
    _freeze_objects()
    return facts


files_here = functools.cache(files_digest)


@functools.cache
def _freeze_objects() -> None:
    """Exclude the objects that all runs of a sweep use from garbage collection, after the first run."""
    gc.collect()
    gc.freeze()


def trial(path: Path, drive: str | None, settings: Sequence[str], claims: str = "") -> dict[str, Any]:
    """Run one experiment of a sweep and return its `run_fields`.

    Every error of the run is caught: the fields then have the status and the reason, and no metrics. With the `claims`
    "fig4", these are judged on the run and its companion without force control, which is also run.
    """
    began = time.perf_counter()
    try:
        done, metrics = _simulate(load_experiment(path, settings, drive), bool(claims))
        assert done.numbers is not None
        hold = done.numbers.measures["hold_error"]
        more: dict[str, Any] = {}
        if claims and not done.reason:
            companion, _ = _simulate(load_experiment(path, [*settings, COMPANION_SETTING], drive), True)
            if companion.reason:
                raise ComponentFailed(f"without force control: {companion.reason}")
            assert done.trace is not None and companion.trace is not None
            more = findings(Fig4Runs(Fig4Run(done.trace), Fig4Run(companion.trace)))
        if hold.value is None:
            more["no_hold"] = hold.reason
    # An internal error in one run of a thousand becomes a row too.
    except Exception as problem:
        return run_fields(*_status_and_reason(problem), {}, time.perf_counter() - began, 0.0)
    return run_fields(done.status, done.reason, metrics, time.perf_counter() - began, done.stepping, **more)


def record_run(path: Path, drive: str | None, settings: Sequence[str], folder: Path) -> None:
    """Run one experiment of a sweep and record it in a folder; a failed run is recorded, too."""
    # The run's result comes from `trial`, so failures are ignored here.
    try:
        experiment = load_experiment(path, settings, drive)
    except InputRefused:
        return
    make_folder(folder)
    with contextlib.suppress(InputRefused, ComponentFailed):
        execute(experiment, folder)


def _status_and_reason(problem: Exception) -> tuple[str, str]:
    match problem:
        case InputRefused():
            return "refused", str(problem)
        case ComponentFailed():
            return "failed", str(problem).splitlines()[0]
    return "failed", f"{type(problem).__name__}: {problem}"


def _simulate(experiment: Experiment, whole: bool) -> tuple[Outcome, dict[str, float | None]]:
    """Simulate a run, with all signals if `whole` or the experiment has measures; return outcome and metrics."""
    runs = Runs(SIGNALS_REQUEST, most=0) if experiment.measures or whole else _runs
    done = runs.run(experiment).require_success()
    assert done.numbers is not None
    metrics = metrics_of(done.numbers)
    if experiment.measures:
        assert done.trace is not None
        signals = Signals(done.trace, geometry_of(experiment.controller.model))
        for measure in experiment.measures:
            # Some values give no step or no contact force; the measure then has no metrics.
            with contextlib.suppress(InputRefused):
                metrics |= {name: m.value for name, m in metrics_of_measure(measure, signals).items()}
    return done, metrics
