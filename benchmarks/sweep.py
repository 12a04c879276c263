"""What a sweep costs beyond stepping, what a second process brings, and what a worker keeps."""

import tempfile
import time
from dataclasses import replace
from pathlib import Path

from benchmarks.measurement import Measurement
from twin.kernel.process.job import JobLimits
from twin.kernel.process.warm import WarmProcess
from twin.studies.sweep import WORKER_JOB
from twin.studies.sweep.engine import Job, LocalEngine, run_facts
from twin.studies.sweep.plan import SweepPlan, Task, plan_of, short_definition

WARM_UP = 5
"""Runs of each process until everything is imported, compiled and unpacked."""
RUNS = 60
"""Of each process after that."""
MANY = 500
"""Short runs, for memory."""
KEY = "contact.stiffness_N_per_m"


def measurements(path: Path) -> list[Measurement]:
    """The lines of the table for the experiment at `path`."""
    plan = plan_of(
        short_definition(path, [f"{KEY}=500:5000:{2 * (RUNS + WARM_UP)}"], None), path, path.stem, "benchmark"
    )
    with tempfile.TemporaryDirectory() as scratch:
        job = Job(experiment=path, recordings=Path(scratch), record="none", limits=JobLimits(), claims="")
        # in turn, so that a machine that slows down or speeds up does so for both
        rounds = [(warm_run(job, plan, 1), warm_run(job, plan, 2)) for _ in range(3)]
        early, late = memory(job, plan.tasks[0])
    one, two = min(one for (one, _), _ in rounds), min(two for _, (two, _) in rounds)
    overhead = min(each - stepping for (each, stepping), _ in rounds)
    return [
        Measurement("sweep: a run of Fig. 4 in a warm process", 1e3 * one, "ms"),
        Measurement("sweep: of that, all but stepping", 1e3 * overhead, "ms", at_most=10.0),
        Measurement("sweep: two processes against one", one / two, "x", at_least=1.9),
        Measurement("sweep: worker after 100 runs", early / 1e6, "MB", at_most=350.0),
        Measurement(f"sweep: worker after {MANY} runs", late / 1e6, "MB", at_most=350.0),
    ]


def warm_run(job: Job, plan: SweepPlan, processes: int) -> tuple[float, float]:
    """(wall time between two runs, wall time of stepping in each) of warm processes (s)."""
    tasks = plan.tasks[: processes * (RUNS + WARM_UP)]
    done, began, first = 0, 0.0, 0
    stepping: list[float] = []
    for batch in LocalEngine(processes).results(job, tasks):
        done += len(batch)
        if not began and done >= processes * WARM_UP:
            began, first = time.perf_counter(), done
            continue
        stepping += [facts["stepping_s"] for _, facts in batch]
        # when the last process is alone the others do nothing
        if done > len(tasks) - processes:
            break
    seconds = time.perf_counter() - began
    return seconds / (done - first), sum(stepping) / len(stepping)


def memory(job: Job, task: Task) -> tuple[int, int]:
    """Resident memory of a worker after 100 and after `MANY` short runs (bytes)."""
    found = []
    with WarmProcess(WORKER_JOB, job.limits) as process:
        for run in range(1, MANY + 1):
            settings = (f"{KEY}={500 + run}", "duration_s=2")
            run_facts(job, process, replace(task, run=run, settings=settings))
            if run in (100, MANY):
                found.append(process.memory)
    early, late = found
    return early, late
