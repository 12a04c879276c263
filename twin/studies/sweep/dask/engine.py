"""The engine of a Dask cluster: runs go out in small batches, a few for each thread, and come back as they are done."""

import queue
import time
import uuid
from collections import deque
from collections.abc import Generator, Sequence
from concurrent.futures import CancelledError
from contextlib import suppress
from typing import TYPE_CHECKING

from twin.errors import ComponentFailed, InputRefused, TwinError
from twin.studies.sweep.dask import depot
from twin.studies.sweep.dask.cluster import connected
from twin.studies.sweep.dask.delivery import deliver, refusal, surveyed
from twin.studies.sweep.dask.parcel import Order, Parcel
from twin.studies.sweep.dask.recordings import keep_recording
from twin.studies.sweep.dask.versions import difference, versions
from twin.studies.sweep.dask.workplace import Errand, Reply, leave, ran
from twin.studies.sweep.engine import Job, Result
from twin.studies.sweep.measures import Finding
from twin.studies.sweep.plan import Task

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
FORSAKEN = 30.0
"""Seconds without any worker after which nobody waits for one any more."""


DIED = Finding("failed", "the Dask worker died whenever it was tried", {}, float("nan"), float("nan")).facts


class ClusterLost(ComponentFailed):
    """The scheduler or all of its workers are gone; rows until then are kept."""


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
        parcel = Parcel(job.experiment)
        orders = [parcel.order(task) for task in tasks]
        with connected(self._scheduler, min(self._processes, len(tasks))) as client:
            ours = versions()
            deliver(client, parcel.contents, surveyed(client, parcel.contents))
            errand = Errand(uuid.uuid4().hex, ours, parcel.label, job.record, job.limits, job.claims, job.reuse)
            campaign = _Campaign(client, job, errand, parcel, tasks)
            try:
                yield from campaign.results(orders)
            finally:
                campaign.stop()


class _Campaign:
    """A sweep while it goes on."""

    def __init__(self, client: "Client", job: Job, errand: Errand, parcel: Parcel, tasks: Sequence[Task]):
        self._client, self._job, self._errand, self._parcel = client, job, errand, parcel
        self._address: str = client.scheduler_info()["address"]
        self._tasks = {task.run: task for task in tasks}
        self._under_way: dict[Future, list[Order]] = {}
        self._ended: queue.SimpleQueue[Future] = queue.SimpleQueue()
        self._seconds = BATCH_SECONDS
        self._threads, self._looked, self._manned = 1, -LOOK, time.monotonic()

    def results(self, orders: Sequence[Order]) -> Generator[list[Result]]:
        """Of all `orders`, as `Dask.results`."""
        waiting, left = deque(orders), len(orders)
        # a batch whose worker died is tried again run by run: only that shows which of them is to blame
        suspects: deque[Order] = deque()
        while left:
            self._look()
            while (suspects or waiting) and len(self._under_way) < AHEAD * self._threads:
                self._send([suspects.popleft()] if suspects else self._batch(waiting))
            results: list[Result] = []
            for batch, reply in self._replies():
                if reply:
                    results += self._received(reply)
                    seen = {each.run for each in reply.yields}
                    waiting.extendleft(order for order in reversed(batch) if order[0] not in seen)
                elif len(batch) > 1:
                    suspects.extend(batch)
                else:
                    results.append((self._tasks[batch[0][0]], DIED))
            if results:
                left -= len(results)
                yield results

    def stop(self) -> None:
        """End what is under way, in every worker."""
        # of a cluster that is gone there is nothing to end, and that it is gone has been said
        with suppress(Exception):
            if self._client.status == "running":
                self._client.cancel(list(self._under_way), force=True)
                self._client.run(leave, self._errand.sweep, on_error="ignore")

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
            threads = sum(self._client.nthreads().values())
        except (TimeoutError, OSError):
            raise self._lost() from None
        self._looked = time.monotonic()
        if threads:
            self._threads, self._manned = threads, self._looked
        elif self._looked - self._manned > FORSAKEN:
            raise ClusterLost(
                f"the last worker of {self._address} has been gone for {FORSAKEN:g} s; finished runs are kept. "
                f"Start others with dask worker {self._address} --nthreads 1, then give the same command to go on"
            )

    def _lost(self) -> ClusterLost:
        return ClusterLost(
            f"the scheduler {self._address} is gone; finished runs are kept. "
            "Start it and its workers again, then give the same command to go on"
        )

    def _batch(self, waiting: deque[Order]) -> list[Order]:
        """As many runs as a batch should take; fewer towards the end, so that all threads end together."""
        share = -(-len(waiting) // (AHEAD * self._threads))
        seconds = max(BATCH_SECONDS, PER_THREAD * self._threads)
        size = max(1, min(int(seconds / self._seconds), MOST_OF_BATCH, share))
        return [waiting.popleft() for _ in range(size)]

    def _send(self, batch: list[Order]) -> None:
        future = self._client.submit(ran, self._errand, batch, pure=False, retries=0)
        self._under_way[future] = batch
        future.add_done_callback(self._ended.put)

    def _replies(self) -> list[tuple[list[Order], Reply | None]]:
        """Of the batches that ended since the last call; none if nothing happens for a while. None: its worker died.

        Raises:
            ClusterLost: the scheduler is gone.
            TwinError: no run can go on.
        """
        try:
            ended = [self._ended.get(timeout=LOOK)]
        except queue.Empty:
            return []
        while not self._ended.empty():
            ended.append(self._ended.get())
        batches = [self._under_way.pop(future) for future in ended]
        died = [future.status == "error" and _worker_died(future, self._address) for future in ended]
        try:
            # all at once: each of them alone would be a question to the scheduler
            fine = iter(self._client.gather([future for future, dead in zip(ended, died, strict=True) if not dead]))
        except (TimeoutError, OSError, CancelledError):
            raise self._lost() from None
        return [(batch, None if dead else next(fine)) for batch, dead in zip(batches, died, strict=True)]

    def _received(self, reply: Reply) -> list[Result]:
        """The results in `reply`; what the worker lacks is on its way to it."""
        if reply.versions is not None:
            raise InputRefused(refusal(difference(f"worker {reply.address}", reply.versions, self._errand.versions)))
        if reply.missing:
            contents = {digest: self._parcel.contents[digest] for digest in reply.missing}
            self._client.run(depot.keep, contents, workers=[reply.address], on_error="ignore")
        for each in reply.yields:
            keep_recording(self._job.recordings / f"{each.run:06d}", each.files)
        costs = [each.facts["seconds"] for each in reply.yields if each.facts["seconds"]]
        if costs:
            self._seconds += 0.3 * (sum(costs) / len(costs) - self._seconds)
        return [(self._tasks[each.run], each.facts) for each in reply.yields]


def _worker_died(future: "Future", address: str) -> bool:
    """Whether that is why `future` has failed.

    Raises:
        TwinError: it is not.
    """
    from distributed import KilledWorker

    problem = future.exception()
    if isinstance(problem, KilledWorker):
        return True
    if isinstance(problem, TwinError):
        raise problem
    raise ComponentFailed(f"a worker of {address} cannot run a sweep: {type(problem).__name__}: {problem}")
