"""The engine of this machine: a thread per worker process, so that each is watched closely and costs only itself."""

import queue
import threading
from collections.abc import Generator, Sequence

from twin.studies.sweep.engine import Job, Result
from twin.studies.sweep.plan import Task
from twin.studies.sweep.station import Station


class Pool:
    """An `Engine` of `processes` processes on this machine."""

    def __init__(self, processes: int):
        self._processes = processes

    def results(self, job: Job, tasks: Sequence[Task]) -> Generator[list[Result]]:
        """See `Engine`."""
        crew = _Crew(job, tasks)
        threads = [threading.Thread(target=crew.feed) for _ in range(min(self._processes, len(tasks)))]
        for thread in threads:
            thread.start()
        try:
            left = len(tasks)
            while left:
                batch = crew.batch()
                left -= len(batch)
                yield batch
        finally:
            crew.stopping.set()
            for thread in threads:
                thread.join()


class _Crew:
    """The threads' common ground."""

    def __init__(self, job: Job, tasks: Sequence[Task]):
        self._job, self._tasks = job, iter(tasks)
        self._lock = threading.Lock()
        self._results: queue.SimpleQueue[Result | Exception] = queue.SimpleQueue()
        self.stopping = threading.Event()

    def batch(self) -> list[Result]:
        """All that has come since the last call, at least one."""
        batch: list[Result] = []
        while not batch or not self._results.empty():
            result = self._results.get()
            if not isinstance(result, Exception):
                batch.append(result)
            elif not batch:
                raise result
            else:
                # what is finished is handed over first
                self._results.put(result)
                break
        return batch

    def feed(self) -> None:
        """The life of a thread: one run after the other, for as long as there are any."""
        try:
            with Station(self._job) as station:
                while (task := self._claimed()) is not None:
                    facts = station.facts(task, self.stopping)
                    if facts is not None:
                        self._results.put((task, facts))
        except Exception as problem:
            self._results.put(problem)

    def _claimed(self) -> Task | None:
        with self._lock:
            return None if self.stopping.is_set() else next(self._tasks, None)
