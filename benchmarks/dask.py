"""What the Dask engine costs: each run, each batch in scheduler and client, each byte of an FMU, the start."""

import os
import tempfile
import time
from importlib.util import find_spec
from pathlib import Path
from statistics import median

from benchmarks.measurement import Measurement
from twin.kernel.process.job import JobLimits
from twin.studies.sweep.plan import SweepPlan, plan_of, short_definition
from twin.studies.sweep.sweep import Engine, Job, Pool

WARM_UP = 10
"""Runs until everything is imported, compiled and unpacked, and batches have found their size."""
RUNS = 60
"""After that."""
ROUNDS = 3
BATCHES = 2000
"""That do nothing, to see what the scheduler and the client need for each."""
MEGABYTES = 50
"""Of an FMU that is sent."""


def measurements(path: Path) -> list[Measurement]:
    """The lines of the table for the experiment at `path`."""
    if find_spec("distributed") is None:
        remark = "Dask engine: distributed not installed"
        return [Measurement("dask: added to a run", None, "", remark=remark)]
    from twin.studies.sweep.dask.cluster import connected
    from twin.studies.sweep.dask.engine import Dask

    plan = plan_of(
        short_definition(path, [f"contact.stiffness_N_per_m=500:5000:{RUNS + WARM_UP}"], None), path, path.stem, "bench"
    )
    with tempfile.TemporaryDirectory() as scratch:
        job = Job(experiment=path, recordings=Path(scratch), record="none", limits=JobLimits(), claims="")
        added = [overhead(Dask(None, 1), job, plan) - overhead(Pool(1), job, plan) for _ in range(ROUNDS)]
        began = time.perf_counter()
        with connected(None, 1) as client:
            start = time.perf_counter() - began
            batch, rate = batch_seconds(client), bytes_per_second(client, job)
    return [
        Measurement("dask: added to a run", 1e3 * median(added), "ms", at_most=10.0),
        Measurement("dask: a batch in scheduler and client, CPU", 1e3 * batch, "ms"),
        Measurement("dask: an FMU to a worker", rate / 1e6, "MB/s"),
        Measurement("dask: start of a cluster of one's own", start, "s"),
    ]


def overhead(engine: Engine, job: Job, plan: SweepPlan) -> float:
    """Wall time per run of one warm process, but for the run itself (s)."""
    done, began, inside, first = 0, 0.0, 0.0, 0
    for results in engine.results(job, plan.tasks):
        done += len(results)
        if not began:
            if done >= WARM_UP:
                began, first = time.perf_counter(), done
            continue
        inside += sum(facts["seconds"] for _, facts in results)
        seconds = time.perf_counter() - began
    return (seconds - inside) / (done - first)


def batch_seconds(client) -> float:
    """Of each of many batches that do nothing, a thousand bytes each: processor time of scheduler and client (s).

    Both live in this process, and all threads of a cluster share them; what a worker does, each does alone.
    """
    began = time.process_time()
    futures = [client.submit(len, bytes(1000), pure=False) for _ in range(BATCHES)]
    client.gather(futures)
    return (time.process_time() - began) / BATCHES


def bytes_per_second(client, job: Job) -> float:
    """From this process through the scheduler into a worker."""
    from twin.studies.sweep.dask.worker import Bundle, SweepPlugin

    bundle = Bundle(job.experiment)
    bundle.contents["large.fmu"] = os.urandom(MEGABYTES * 1_000_000)
    began = time.perf_counter()
    client.register_plugin(SweepPlugin("benchmark", job, bundle))
    seconds = time.perf_counter() - began
    client.unregister_worker_plugin("benchmark")
    return MEGABYTES * 1e6 / seconds
