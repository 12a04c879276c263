"""The engine of a Dask cluster: runs go out in small batches, a few for each thread, and come back as they are done."""

import queue
import time
import uuid
from collections import deque
from collections.abc import Generator, Sequence
from contextlib import suppress
from typing import TYPE_CHECKING, Any

from twin.errors import ComponentFailed, InputRefused, TwinError
from twin.sweep.dask.cluster import connected
from twin.sweep.dask.delivery import deliver, surveyed
from twin.sweep.dask.parcel import Order, Parcel
from twin.sweep.dask.recordings import keep_recording
from twin.sweep.dask.versions import difference, versions
from twin.sweep.dask.workplace import Errand, Reply, leave, ran
from twin.sweep.engine import Job, Result
from twin.sweep.measures import Finding
from twin.sweep.plan import Task

if TYPE_CHECKING:
    from distributed import Client, Future

BATCH_SECONDS = 0.5
"""What a batch should take: the scheduler's milliseconds do not matter then, and no more is lost with a worker."""
MOST_OF_BATCH = 64
AHEAD = 2
"""Batches per thread that are under way: one that runs, one that waits for it."""
LOOK = 1.0
"""How often (s) the cluster is looked at: connection, threads."""
FORSAKEN = 30.0
"""Seconds without any worker after which nobody waits for one any more."""


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
            deliver(client, parcel.contents, surveyed(client, parcel.contents, ours))
            errand = Errand(uuid.uuid4().hex, ours, parcel.label, job.record, job.limits)
            campaign = _Campaign(client, job, errand, parcel, dict(zip((task.run for task in tasks), tasks, strict=True)))
            try:
                yield from campaign.results(orders)
            finally:
                campaign.stop()


class _Campaign:
    """A sweep while it goes on."""

    def __init__(self, client: "Client", job: Job, errand: Errand, parcel: Parcel, tasks: dict[int, Task]):
        self._client, self._job, self._errand, self._parcel, self._tasks = client, job, errand, parcel, tasks
        self._out: dict[Future, list[Order]] = {}
        self._done: queue.SimpleQueue[Future] = queue.SimpleQueue()
        self._seconds = BATCH_SECONDS
        self._threads, self._looked, self._seen = 1, -LOOK, time.monotonic()

    def results(self, orders: Sequence[Order]) -> Generator[list[Result]]:
        waiting, left = deque(orders), len(orders)
        # a batch in which a worker died is tried again run by run: only that shows which of them is to blame
        single: deque[Order] = deque()
        while left:
            self._look()
            while (single or waiting) and len(self._out) < AHEAD * self._threads:
                self._send([single.popleft()] if single else self._batch(waiting))
            results: list[Result] = []
            for future in self._finished():
                batch = self._out.pop(future)
                if reply := self._reply(future):
                    results += self._received(reply)
                    seen = {each.run for each in reply.yields}
                    waiting.extendleft(order for order in reversed(batch) if order[0] not in seen)
                elif len(batch) > 1:
                    single.extend(batch)
                else:
                    results.append((self._tasks[batch[0][0]], _forsaken()))
            if results:
                left -= len(results)
                yield results

    def stop(self) -> None:
        """End what is under way, in every worker."""
        # a cluster that is gone has nothing to end, and whatever it says of that is known
        with suppress(Exception):
            if self._client.status == "running":
                self._client.cancel(list(self._out), force=True)
                self._client.run(leave, self._errand.sweep, on_error="ignore")

    def _look(self) -> None:
        if self._client.status != "running":
            raise self._lost("the connection was lost")
        if time.monotonic() - self._looked < LOOK:
            return
        try:
            threads = sum(self._client.nthreads().values())
        except (OSError, TimeoutError) as problem:
            raise self._lost(str(problem) or type(problem).__name__) from None
        self._looked = time.monotonic()
        if threads:
            self._threads, self._seen = threads, self._looked
        elif self._looked - self._seen > FORSAKEN:
            raise self._lost(f"it has had no worker for {FORSAKEN:g} s", "dask worker")

    def _batch(self, waiting: deque[Order]) -> list[Order]:
        """As many runs as take `BATCH_SECONDS`; fewer towards the end, so that all threads end together."""
        share = -(-len(waiting) // (AHEAD * self._threads))
        size = max(1, min(int(BATCH_SECONDS / self._seconds), MOST_OF_BATCH, share))
        return [waiting.popleft() for _ in range(size)]

    def _send(self, batch: list[Order]) -> None:
        future = self._client.submit(ran, self._errand, batch, pure=False, retries=0)
        self._out[future] = batch
        future.add_done_callback(self._done.put)

    def _finished(self) -> list["Future"]:
        """Those that are done since the last call; none if nothing happens for a while."""
        try:
            futures = [self._done.get(timeout=LOOK)]
        except queue.Empty:
            return []
        while not self._done.empty():
            futures.append(self._done.get())
        return futures

    def _reply(self, future: "Future") -> Reply | None:
        """What came of a batch; None: its worker has died, each time that somebody tried.

        Raises:
            ClusterLost: the scheduler is gone.
            TwinError: no run can go on.
        """
        from distributed import KilledWorker

        if future.status in ("cancelled", "lost"):
            raise self._lost("the connection was lost")
        try:
            return future.result(timeout=None)
        except KilledWorker:
            return None
        except TwinError:
            raise
        except Exception as problem:
            if self._client.status != "running":
                raise self._lost("the connection was lost") from None
            raise ComponentFailed(
                f"a worker of {self._name} cannot run twin sweep: {type(problem).__name__}: {problem}"
            ) from None

    def _received(self, reply: Reply) -> list[Result]:
        if reply.versions is not None:
            raise InputRefused(unlike(reply.address, reply.versions, self._errand.versions))
        if reply.missing:
            contents = {digest: self._parcel.contents[digest] for digest in reply.missing}
            deliver(self._client, contents, {reply.address: tuple(reply.missing)})
        for each in reply.yields:
            keep_recording(self._job.recordings / f"{each.run:06d}", each.files)
        costs = [each.facts["seconds"] for each in reply.yields if each.facts["seconds"]]
        if costs:
            self._seconds += 0.3 * (sum(costs) / len(costs) - self._seconds)
        return [(self._tasks[each.run], each.facts) for each in reply.yields]
