"""Stability margins of the best runs of a sweep, computed once at its end from the loops of `twin.studies.analyse`."""

import math
import time
from collections.abc import Sequence
from contextlib import closing
from itertools import chain
from pathlib import Path
from typing import Any

from twin.kernel.atomic_write import write_json
from twin.kernel.process.job import JobLimits
from twin.robot.assembly.load import load_experiment
from twin.studies.analyse.stability import force_loop_margins
from twin.studies.command import Say
from twin.studies.sweep.engine import Engine, Job
from twin.studies.sweep.interrupts import defer_interrupts
from twin.studies.sweep.measures import HOLD_ERROR, run_fields
from twin.studies.sweep.plan import SweepPlan
from twin.studies.sweep.show.parts import SweepQuery, best_rows
from twin.studies.sweep.stored import MARGINS_FILE, SweepRows

MAX_MARGIN_RUNS = 12
"""Maximum number of runs; each takes about 0.5 s."""


def write_margins(plan: SweepPlan, found: SweepRows, folder: Path, engine: Engine, limits: JobLimits, say: Say) -> None:
    """Store the margins of the runs with the smallest hold errors, unless they exist or claims are judged."""
    keys = {*found.columns.categorical("key").select(best_rows(found, SweepQuery(HOLD_ERROR, "", MAX_MARGIN_RUNS)))}
    if plan.definition.claims or keys <= found.margins.keys():
        return
    say("margins of the best runs")
    job = Job(plan.experiment, folder, "none", limits, "", f"{__name__}:trial")
    tasks = [task for task in plan.tasks if task.key in keys]
    with defer_interrupts(), closing(engine.results(job, tasks)) as batches:
        results = sorted(chain.from_iterable(batches), key=lambda result: result[0].run)
    none = {"gain": None, "phase_rad": None}
    write_json(folder / MARGINS_FILE, {
        task.key: {"run": task.run, **none, **facts["metrics"], "reason": facts["reason"]} for task, facts in results
    })  # fmt: skip


def trial(path: Path, drive: str | None, settings: Sequence[str], claims: str = "") -> dict[str, Any]:
    """Compute the stability margins of an experiment instead of running it; called in a sweep's worker process."""
    began = time.perf_counter()
    try:
        found = force_loop_margins(load_experiment(path, settings, drive))
    # An internal error must not fail a sweep that is already complete.
    except Exception as problem:
        reason = (str(problem) or type(problem).__name__).splitlines()[0]
        return run_fields("failed", reason, {}, time.perf_counter() - began, math.nan)
    gain = min((one.gain for one in found if one.gain is not None), default=None)
    phase = min((one.phase for one in found if one.phase is not None), default=None)
    return run_fields("done", "", {"gain": gain, "phase_rad": phase}, time.perf_counter() - began, math.nan)
