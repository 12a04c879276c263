"""What the Dask engine costs: each run, each batch in scheduler and client."""

import tempfile
import time
from importlib.util import find_spec
from pathlib import Path
from statistics import median

from benchmarks.measurement import Measurement
from twin.kernel.process.job import JobLimits
from twin.studies.sweep.engine import Engine, Job, LocalEngine
from twin.studies.sweep.plan import SweepPlan, plan_of, short_definition
from twin.studies.sweep.stored import SWEEP_FILE
from twin.studies.sweep.sweep import RECORDINGS_FOLDER

WARM_UP = 10
"""Runs until everything is imported, compiled and unpacked, and batches have found their size."""
RUNS = 60
"""After that."""
ROUNDS = 3
BATCHES = 2000
"""That do nothing, to see what the scheduler and the client need for each."""


def measurements(path: Path) -> list[Measurement]:
    """The lines of the table for the experiment at `path`."""
    if find_spec("distributed") is None:
        remark = "Dask engine: distributed not installed"
        return [Measurement("dask: added to a run", None, "", remark=remark)]
    from distributed import Client, LocalCluster

    from twin.studies.sweep.dask.engine import DaskEngine

    plan = plan_of(
        short_definition(path, [f"contact.stiffness_N_per_m=500:5000:{RUNS + WARM_UP}"], None), path, path.stem, "bench"
    )
    with (
        tempfile.TemporaryDirectory() as scratch,
        LocalCluster(n_workers=1, threads_per_worker=1, host="127.0.0.1", dashboard_address=":0") as cluster,
    ):
        # by which workers see that they share the folder
        (Path(scratch) / SWEEP_FILE).touch()
        recordings = Path(scratch) / RECORDINGS_FOLDER
        job = Job(experiment=path, recordings=recordings, record="none", limits=JobLimits(), claims="")
        engines = DaskEngine(cluster.scheduler_address), LocalEngine(1)
        added = [overhead(engines[0], job, plan) - overhead(engines[1], job, plan) for _ in range(ROUNDS)]
        with Client(cluster) as client:
            batch = batch_seconds(client)
    return [
        Measurement("dask: added to a run", 1e3 * median(added), "ms", at_most=10.0),
        Measurement("dask: a batch in scheduler and client, CPU", 1e3 * batch, "ms"),
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
