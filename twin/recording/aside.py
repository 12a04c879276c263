"""Work that another thread does while the one that asks for it goes on."""

import threading
from collections.abc import Callable
from queue import SimpleQueue

from twin.cores import cores

Job = Callable[[], None]
_Jobs = SimpleQueue[tuple[Job, threading.Lock] | None]


class Aside:
    """Does one job after another: in a thread of its own where there is a second processor, otherwise at once.

    What a job raises is raised in the thread that asks, by the next call of any of these.
    """

    def __init__(self) -> None:
        self._apart = cores() > 1
        self._thread: threading.Thread | None = None
        self._jobs: _Jobs = SimpleQueue()
        self._newest = threading.Lock()
        self._failures: list[BaseException] = []

    def begin(self, job: Job) -> None:
        """Wait until the job before is done, and begin `job`."""
        with self._newest:
            pass
        self.check()
        if not self._apart:
            job()
            return
        if self._thread is None:
            # as a daemon: whoever is forgotten while he waits shall hold up no end of a process
            thread = threading.Thread(target=_work, args=(self._jobs, self._failures), daemon=True)
            thread.start()
            self._thread = thread
        self._newest = self._put(job)

    def wait(self) -> None:
        """Until all jobs are done; then there is no thread any more."""
        thread = self._thread
        if thread is not None:
            # behind all others: an interrupt may have come before it was noted which is the newest
            with self._put(lambda: None):
                self._thread = None
            self._jobs.put(None)
            thread.join()
        self.check()

    def check(self) -> None:
        """Raise what a job has raised."""
        if self._failures:
            failure, *_ = self._failures
            self._failures.clear()
            raise failure

    def _put(self, job: Job) -> threading.Lock:
        """Have `job` done; a lock that is free afterwards."""
        lock = threading.Lock()
        lock.acquire()
        self._jobs.put((job, lock))
        return lock


def _work(jobs: _Jobs, failures: list[BaseException]) -> None:
    while (asked := jobs.get()) is not None:
        job, lock = asked
        try:
            job()
        except BaseException as failure:
            failures.append(failure)
        # it may hold much memory, and the next one may be long in coming
        del asked, job
        lock.release()
