"""The engine of this machine: a thread per worker process, so that each is watched closely and costs only itself."""

import queue
import threading
from collections.abc import Generator, Sequence
from contextlib import closing, suppress

from twin.studies.sweep.engine import Job, Result
from twin.studies.sweep.interrupt import HEAR, raise_if_pressed
from twin.studies.sweep.plan import Task
from twin.studies.sweep.worker_process import WorkerProcess


class Pool:
    """An `Engine` of `processes` processes on this machine."""

    def __init__(self, processes: int):
        self._processes = processes

    def results(self, job: Job, tasks: Sequence[Task]) -> Generator[list[Result]]:
        """See `Engine`."""
        waiting: queue.SimpleQueue[Task] = queue.SimpleQueue()
        for task in tasks:
            waiting.put(task)
        done: queue.SimpleQueue[Result | Exception] = queue.SimpleQueue()
        stopping = threading.Event()

        def work() -> None:
            try:
                with closing(WorkerProcess(job)) as worker, suppress(queue.Empty):
                    while not stopping.is_set():
                        task = waiting.get_nowait()
                        if (facts := worker.facts(task, stopping)) is not None:
                            done.put((task, facts))
            except Exception as problem:
                done.put(problem)

        threads = [threading.Thread(target=work) for _ in range(min(self._processes, len(tasks)))]
        for thread in threads:
            thread.start()
        try:
            left = len(tasks)
            while left:
                batch = _batch(done)
                left -= len(batch)
                yield batch
        finally:
            stopping.set()
            for thread in threads:
                thread.join()


def _batch(done: "queue.SimpleQueue[Result | Exception]") -> list[Result]:
    """All that has come since the last call, at least one; what is finished comes before a failure is raised."""
    batch: list[Result] = []
    while not batch or not done.empty():
        try:
            result = done.get(timeout=HEAR)
        except queue.Empty:
            raise_if_pressed()
            continue
        if not isinstance(result, Exception):
            batch.append(result)
        elif not batch:
            raise result
        else:
            done.put(result)
            break
    return batch
