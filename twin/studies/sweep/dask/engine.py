"""The engine of a Dask cluster: runs go out in small batches, a few for each thread, and come back as they are done."""

import queue
import shutil
import time
import uuid
from collections import deque
from collections.abc import Generator, Mapping, Sequence
from concurrent.futures import CancelledError
from pathlib import Path
from typing import TYPE_CHECKING

from twin.errors import ComponentFailed, InputRefused, NotWritten, TwinError
from twin.studies.sweep.dask import file_store
from twin.studies.sweep.dask.bundle import Bundle
from twin.studies.sweep.dask.cluster import (
    ANSWER,
    END,
    TRANSFER,
    ClusterLost,
    checked_workers,
    connected,
    ended_within,
    refusal,
    send_missing,
    within,
)
from twin.studies.sweep.dask.runner import Reply, SweepJob, close_runner, difference, run_tasks, versions
from twin.studies.sweep.measures import failure
from twin.studies.sweep.plan import Task
from twin.studies.sweep.pool import HEAR, Job, Result, raise_if_pressed
from twin.studies.sweep.rows import DiskFailed
from twin.writing import made_folder, write_bytes

if TYPE_CHECKING:
    from distributed import Client, Future

BATCH_SECONDS = 0.5
"""What a batch should take: the scheduler's milliseconds do not matter then, and no more is lost with a worker."""
PER_THREAD = 0.004
"""Seconds that it should take at least for each thread there is: all of them share one scheduler and one client, which
need about 2 ms for a batch (docs/cluster.md)."""
MOST_OF_BATCH = 256
AHEAD = 2
"""Batches per thread that are under way: one that runs, one that waits for it."""
LOOK = 1.0
"""How often (s) the cluster is looked at: connection, threads."""
NO_WORKERS = 30.0
"""Seconds without any worker after which nobody waits for one any more."""
DIED = failure("the Dask worker died whenever it was tried")


class Dask:
    """An `Engine` of the workers of a Dask cluster.

    Args:
        scheduler: its address; None: a cluster of this machine that lives as long as the sweep.
        processes: workers of that.
    """

    def __init__(self, scheduler: str | None, processes: int):
        self._scheduler, self._processes = scheduler, processes

    def results(self, job: Job, tasks: Sequence[Task]) -> Generator[list[Result]]:
        """See `Engine`.

        Raises:
            InputRefused: there is no such cluster, it has no workers, or they are not like this machine.
            ClusterLost: it was there and is gone.
        """
        bundle = Bundle(job.experiment)
        packed = [bundle.packed(task) for task in tasks]
        with connected(self._scheduler, min(self._processes, len(tasks))) as client:
            sweep = SweepJob(uuid.uuid4().hex, versions(), bundle.manifest, job)
            send_missing(client, bundle.contents, checked_workers(client, sweep))
            batches = _Batches(client, sweep, bundle.contents, tasks)
            try:
                yield from batches.results(packed)
            finally:
                batches.stop()


class _Batches:
    """Those of a sweep that are under way."""

    def __init__(self, client: "Client", sweep: SweepJob, contents: Mapping[str, bytes], tasks: Sequence[Task]):
        self._client, self._sweep, self._contents = client, sweep, contents
        self._address: str = within(ANSWER, client.scheduler_info)["address"]
        self._tasks = {task.run: task for task in tasks}
        self._under_way: dict[Future, list[Task]] = {}
        self._ended: queue.SimpleQueue[Future] = queue.SimpleQueue()
        self._seconds = BATCH_SECONDS
        self._threads, self._looked, self._worker_seen = 1, -LOOK, time.monotonic()

    def results(self, packed: Sequence[Task]) -> Generator[list[Result]]:
        """Of all tasks, `packed`, as `Dask.results`."""
        waiting, left = deque(packed), len(packed)
        # a batch whose worker died is tried again run by run: only that shows which of them is to blame
        suspects: deque[Task] = deque()
        while left:
            raise_if_pressed()
            self._look()
            while (suspects or waiting) and len(self._under_way) < AHEAD * self._threads:
                self._send([suspects.popleft()] if suspects else self._batch(waiting))
            results: list[Result] = []
            for batch, reply in self._replies():
                if reply:
                    results += self._received(reply)
                    seen = {each.run for each in reply.results}
                    waiting.extendleft(task for task in reversed(batch) if task.run not in seen)
                elif len(batch) > 1:
                    suspects.extend(batch)
                else:
                    results.append((self._tasks[batch[0].run], DIED))
            if results:
                left -= len(results)
                yield results

    def stop(self) -> None:
        """End what is under way, in every worker."""
        # of a cluster that is gone there is nothing to end, and that it is gone has been said
        if self._client.status == "running":
            ended_within(END, self._client.cancel, list(self._under_way), force=True)
            ended_within(END, self._client.run, close_runner, self._sweep.sweep, on_error="ignore")

    def _look(self) -> None:
        """Look after the cluster, now and then.

        Raises:
            ClusterLost: it is gone.
        """
        if self._client.status != "running":
            raise self._lost()
        if time.monotonic() - self._looked < LOOK:
            return
        try:
            threads = sum(within(ANSWER, self._client.nthreads).values())
        except (TimeoutError, OSError):
            raise self._lost() from None
        self._looked = time.monotonic()
        if threads:
            self._threads, self._worker_seen = threads, self._looked
        elif self._looked - self._worker_seen > NO_WORKERS:
            raise ClusterLost(
                f"the last worker of {self._address} has been gone for {NO_WORKERS:g} s; finished runs are kept. "
                f"Start others with dask worker {self._address} --nthreads 1, then give the same command to go on"
            )

    def _lost(self) -> ClusterLost:
        return ClusterLost(
            f"the scheduler {self._address} is gone; finished runs are kept. "
            "Start it and its workers again, then give the same command to go on"
        )

    def _batch(self, waiting: deque[Task]) -> list[Task]:
        """As many runs as a batch should take; fewer towards the end, so that all threads end together."""
        share = -(-len(waiting) // (AHEAD * self._threads))
        seconds = max(BATCH_SECONDS, PER_THREAD * self._threads)
        size = max(1, min(int(seconds / self._seconds), MOST_OF_BATCH, share))
        return [waiting.popleft() for _ in range(size)]

    def _send(self, batch: list[Task]) -> None:
        try:
            future = within(ANSWER, self._client.submit, run_tasks, self._sweep, batch, pure=False, retries=0)
        except TimeoutError:
            raise self._lost() from None
        self._under_way[future] = batch
        future.add_done_callback(self._ended.put)

    def _replies(self) -> list[tuple[list[Task], Reply | None]]:
        """Of the batches that ended since the last call; none if nothing happens for a while. None: its worker died.

        Raises:
            ClusterLost: the scheduler is gone.
            TwinError: no run can go on.
        """
        try:
            ended = [self._ended.get(timeout=HEAR)]
        except queue.Empty:
            return []
        while not self._ended.empty():
            ended.append(self._ended.get())
        batches = [self._under_way.pop(future) for future in ended]
        died = [future.status == "error" and _worker_died(future, self._address) for future in ended]
        try:
            # all at once: each of them alone would be a question to the scheduler
            alive = [future for future, dead in zip(ended, died, strict=True) if not dead]
            fine = iter(within(TRANSFER, self._client.gather, alive))
        except (TimeoutError, OSError, CancelledError):
            raise self._lost() from None
        return [(batch, None if dead else next(fine)) for batch, dead in zip(batches, died, strict=True)]

    def _received(self, reply: Reply) -> list[Result]:
        """The results in `reply`; what the worker lacks is on its way to it."""
        if reply.versions is not None:
            raise InputRefused(refusal(difference(f"worker {reply.address}", reply.versions, self._sweep.versions)))
        if reply.missing:
            contents = {digest: self._contents[digest] for digest in reply.missing}
            try:
                within(
                    TRANSFER, self._client.run, file_store.keep, contents, workers=[reply.address], on_error="ignore"
                )
            except TimeoutError:
                raise self._lost() from None
        for each in reply.results:
            _keep_recording(self._sweep.job.recordings / f"{each.run:06d}", each.files)
        costs = [each.facts["seconds"] for each in reply.results if each.facts["seconds"]]
        if costs:
            self._seconds += 0.3 * (sum(costs) / len(costs) - self._seconds)
        return [(self._tasks[each.run], each.facts) for each in reply.results]


def _keep_recording(folder: Path, files: Mapping[str, bytes]) -> None:
    """Make `folder` that of a run with `files`; without files nothing is done.

    Raises:
        DiskFailed: they cannot be written; nothing of them is left.
    """
    if not files:
        return
    # what an interrupted sweep left of the same run
    shutil.rmtree(folder, ignore_errors=True)
    try:
        made_folder(folder)
        for name, content in files.items():
            write_bytes(folder / name, content)
    except (InputRefused, NotWritten) as problem:
        shutil.rmtree(folder, ignore_errors=True)
        raise DiskFailed(f"{problem}; finished runs are kept. Make room, then give the same command to go on") from None


def _worker_died(future: "Future", address: str) -> bool:
    """Whether that is why `future` has failed.

    Raises:
        TwinError: it is not.
    """
    from distributed import KilledWorker

    try:
        problem = within(ANSWER, future.exception)
    except TimeoutError as silent:
        problem = silent
    if isinstance(problem, KilledWorker):
        return True
    if isinstance(problem, TwinError):
        raise problem
    raise ComponentFailed(f"a worker of {address} cannot run a sweep: {type(problem).__name__}: {problem}")
