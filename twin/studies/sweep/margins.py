"""Stability margins of the best runs of a sweep, from the linear loops of `twin.studies.analyse`."""

import math
import os
import time
from collections.abc import Mapping, Sequence
from contextlib import closing
from pathlib import Path
from typing import Any, NamedTuple

from twin.kernel.errors import InputRefused, TwinError
from twin.kernel.process.job import JobLimits, cores
from twin.robot.assembly.load import load_experiment
from twin.studies.analyse.stability import force_loop_margins
from twin.studies.sweep.measures import RunFinding
from twin.studies.sweep.plan import DesignPoint, tasks_again
from twin.studies.sweep.rows import SweepRows
from twin.studies.sweep.sweep import Job, Pool, remembered

MOST = 12
"""Maximum number of runs, each of which takes about half a second."""
CHANGED = "twin, the experiment, a body or an FMU has changed since"


class RunMargins(NamedTuple):
    """Margins of the force loop where the robot presses, the smallest over the places.

    Attributes:
        gain: factor by which the gain may grow; None: by any.
        phase: rad; None if the loop's gain never reaches 1.
        reason: why there are no margins; "" if there are.
    """

    gain: float | None = None
    phase: float | None = None
    reason: str = ""


def best_margins(sweep: SweepRows, rows: Sequence[int]) -> dict[int, RunMargins]:
    """Compute the margins of runs in guarded processes, as drives are native code.

    Args:
        rows: positions in the columns, `MOST` of which are taken.

    Returns: by number of the run; empty if the sweep does not say where its experiment is.
    """
    if not sweep.origin or os.name != "posix":
        return {}
    columns = sweep.columns
    labels = columns.under("parameters")
    runs = []
    for row in list(rows)[:MOST]:
        values = {label: columns.of[name][row] for label, name in labels.items()}
        values = {k: v.item() if hasattr(v, "item") else v for k, v in values.items() if v is not None and v == v}
        runs.append((columns.run(row), columns.words("key")[row], DesignPoint(columns.words("drive")[row], values)))
    try:
        tasks = tasks_again(sweep.origin, runs)
    except InputRefused as refusal:
        return {run: RunMargins(reason=str(refusal).splitlines()[-1]) for run, _, _ in runs}
    found = {run: RunMargins(reason=CHANGED) for run, _, _ in runs}
    job = Job(Path(sweep.origin["file"]), Path(), "none", JobLimits(), "", f"{__name__}:trial")
    if tasks:
        with remembered(), closing(Pool(cores()).results(job, tasks)) as batches:
            for task, facts in (result for batch in batches for result in batch):
                metrics: Mapping[str, Any] = facts["metrics"]
                found[task.run] = RunMargins(metrics.get("gain"), metrics.get("phase"), facts["reason"])
    return found


def trial(path: Path, drive: str | None, settings: Sequence[str], claims: str = "") -> RunFinding:
    """Compute the margins of an experiment instead of running it; called by a worker process."""
    began = time.perf_counter()
    try:
        found = force_loop_margins(load_experiment(path, settings, drive))
    except TwinError as problem:
        return RunFinding("failed", str(problem).splitlines()[0], {}, time.perf_counter() - began, math.nan)
    gain = min((one.gain for one in found if one.gain is not None), default=None)
    phase = min((one.phase for one in found if one.phase is not None), default=None)
    return RunFinding("done", "", {"gain": gain, "phase": phase}, time.perf_counter() - began, math.nan)
