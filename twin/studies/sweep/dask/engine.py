"""The engine of a Dask cluster: runs are sent in small batches, a few per thread, and return as they are done."""

import time
import uuid
from collections import deque
from collections.abc import Generator, Sequence
from concurrent.futures import CancelledError
from dataclasses import replace
from typing import Any

from distributed import Client, Future, KilledWorker, as_completed

from twin.kernel.errors import ComponentFailed, TwinError
from twin.studies.sweep.dask.cluster import (
    ANSWER_TIMEOUT,
    END_TIMEOUT,
    ClusterLost,
    attempt_with_timeout,
    call_with_timeout,
    connect_client,
)
from twin.studies.sweep.dask.worker import EndPlugin, RunFacts, SweepPlugin, run_tasks
from twin.studies.sweep.engine import Job, Result
from twin.studies.sweep.interrupts import raise_interrupt
from twin.studies.sweep.measures import failure
from twin.studies.sweep.plan import Task, files_digest, text_settings

BATCH_SECONDS = 0.5
"""Target duration of a batch (s): the scheduler's milliseconds are negligible, little is lost with a worker."""
MIN_SECONDS_PER_THREAD = 0.004
"""Minimum batch per thread (s): scheduler and client need about 2 ms per batch (docs/sweep.md)."""
MAX_BATCH_SIZE = 256
BATCHES_PER_THREAD = 2
"""Number of batches in progress per thread: one running, one queued."""
POLL_PERIOD = 0.01
"""Period of polling for completed batches (s)."""
CHECK_PERIOD = 1.0
"""Period of checking the connection and counting threads (s)."""
WORKER_TIMEOUT = 30.0
"""Time without any worker after which the sweep ends (s)."""
WORKER_DEATH = failure("the Dask worker died whenever it was tried")


class DaskEngine:
    def __init__(self, scheduler: str):
        self._scheduler = scheduler

    def results(self, job: Job, tasks: Sequence[Task]) -> Generator[list[Result]]:
        """Run the tasks and yield results in batches; refuse unlike clusters, raise `ClusterLost` if gone."""
        files = dict.fromkeys((task.drive, text_settings(task.settings)) for task in tasks)
        job = replace(job, files={each: files_digest(job.experiment, *each) for each in files})
        with connect_client(self._scheduler) as client:
            batches = _Batches(client, job, tasks)
            try:
                batches.begin()
                yield from batches.results()
            finally:
                batches.stop()


class _Batches:
    def __init__(self, client: Client, job: Job, tasks: Sequence[Task]):
        assert client.scheduler is not None
        self._client, self._job, self._sweep = client, job, uuid.uuid4().hex
        self._address = client.scheduler.address
        self._tasks = {task.run: task for task in tasks}
        self._under_way: dict[Future, list[Task]] = {}
        self._ended = as_completed(loop=client.loop, with_results=True, raise_errors=False)
        self._seconds = BATCH_SECONDS
        self._threads, self._looked, self._worker_seen = 1, -CHECK_PERIOD, time.monotonic()

    def begin(self) -> None:
        """Register the sweep with scheduler, present and future workers; raise `ClusterLost` without an answer."""
        for plugin in (EndPlugin(self._sweep, self._client.id), SweepPlugin(self._sweep, self._job)):
            try:
                call_with_timeout(ANSWER_TIMEOUT, self._client.register_plugin, plugin)
            except OSError as problem:
                raise ClusterLost(
                    f"{self._address}: its workers did not take the sweep ({problem}); repeat the command"
                ) from None

    def results(self) -> Generator[list[Result]]:
        # Keys and parameters are not needed to make a run.
        waiting = deque(replace(task, key="", parameters={}) for task in self._tasks.values())
        left = len(waiting)
        # A batch whose worker died is retried run by run, to identify the run that killed it.
        suspects: deque[Task] = deque()
        while left:
            raise_interrupt()
            self._check_cluster()
            while (suspects or waiting) and len(self._under_way) < BATCHES_PER_THREAD * self._threads:
                self._send([suspects.popleft()] if suspects else self._batch(waiting))
            results: list[Result] = []
            for future, reply in self._ended.next_batch(block=False):
                batch = self._under_way.pop(future)
                if not self._is_worker_death(reply):
                    results += self._unpack_reply(reply)
                elif len(batch) > 1:
                    suspects.extend(batch)
                else:
                    results.append((self._tasks[batch[0].run], WORKER_DEATH))
            if results:
                left -= len(results)
                yield results
            else:
                time.sleep(POLL_PERIOD)

    def stop(self) -> None:
        # A lost cluster needs no cleanup, and the loss is already reported.
        if self._client.status == "running":
            attempt_with_timeout(END_TIMEOUT, self._client.cancel, list(self._under_way), force=True)
            attempt_with_timeout(END_TIMEOUT, self._client.unregister_worker_plugin, self._sweep)

    def _check_cluster(self) -> None:
        """Check that the cluster is connected, and count its threads, at most once per `CHECK_PERIOD`."""
        if self._client.status != "running":
            raise self._cluster_error()
        if time.monotonic() - self._looked < CHECK_PERIOD:
            return
        try:
            threads = sum(call_with_timeout(ANSWER_TIMEOUT, self._client.nthreads).values())
        except OSError:
            raise self._cluster_error() from None
        self._looked = time.monotonic()
        if threads:
            self._threads, self._worker_seen = threads, self._looked
        elif self._looked - self._worker_seen > WORKER_TIMEOUT:
            raise ClusterLost(
                f"the last worker of {self._address} has been gone for {WORKER_TIMEOUT:g} s; finished runs are kept. "
                f"Start others with dask worker {self._address} --nthreads 1, then repeat the command to continue"
            )

    def _cluster_error(self) -> ClusterLost:
        return ClusterLost(
            f"the scheduler {self._address} is gone; finished runs are kept. "
            "Start it and its workers again, then repeat the command to continue"
        )

    def _batch(self, waiting: deque[Task]) -> list[Task]:
        """Take the next batch off the waiting runs; batches shrink at the end, so that all threads finish together."""
        share = -(-len(waiting) // (BATCHES_PER_THREAD * self._threads))
        seconds = max(BATCH_SECONDS, MIN_SECONDS_PER_THREAD * self._threads)
        size = max(1, min(int(seconds / self._seconds), MAX_BATCH_SIZE, share))
        return [waiting.popleft() for _ in range(size)]

    def _send(self, batch: list[Task]) -> None:
        future = self._client.submit(run_tasks, self._sweep, batch, pure=False)
        self._under_way[future] = batch
        self._ended.add(future)

    def _is_worker_death(self, reply: Any) -> bool:
        match reply:
            case list():
                return False
            case _, KilledWorker(), _:
                return True
            case _, TwinError() as problem, _:
                raise problem
            case CancelledError():
                raise self._cluster_error()
        problem = reply[1] if isinstance(reply, tuple) else reply
        raise ComponentFailed(f"a worker of {self._address} cannot run a sweep: {type(problem).__name__}: {problem}")

    def _unpack_reply(self, reply: Sequence[RunFacts]) -> list[Result]:
        """Convert a worker's reply to results, and update the estimated duration of a run."""
        costs = [facts["seconds"] for _, facts in reply if facts["seconds"]]
        if costs:
            self._seconds += 0.3 * (sum(costs) / len(costs) - self._seconds)
        return [(self._tasks[run], facts) for run, facts in reply]
