"""Work that another thread does while the one that asks goes on."""

import os
import threading
from collections.abc import Callable
from queue import SimpleQueue

Job = Callable[[], None]


def processors() -> int:
    """On how many this process may run."""
    return len(os.sched_getaffinity(0)) if hasattr(os, "sched_getaffinity") else os.cpu_count() or 1


class Aside:
    """Does one job after another, in a thread of its own where there is a second processor, otherwise at once.

    An error is raised where the next job is begun or waited for, in the thread that asks. Jobs should mostly be such as
    hold no lock of the interpreter: compressing, checksums, writing.
    """

    def __init__(self) -> None:
        self._apart = processors() > 1
        self._thread: threading.Thread | None = None
        self._jobs: SimpleQueue[tuple[Job, threading.Lock] | None] = SimpleQueue()
        self._failures: list[BaseException] = []
        self._newest = threading.Lock()

    def begin(self, job: Job) -> None:
        """Wait until the job before is done; do `job`, or let it be done."""
        with self._newest:
            pass
        self._tell()
        if not self._apart:
            job()
            return
        if self._thread is None:
            self._thread = threading.Thread(target=_work, args=(self._jobs, self._failures), daemon=True)
            self._thread.start()
        self._newest = self._put(job)

    def wait(self) -> None:
        """Until all jobs are done; then there is no thread any more."""
        if self._thread is not None:
            # one more job, because an interrupt may have made us forget which was the newest
            with self._put(lambda: None):
                self._jobs.put(None)
            self._thread.join()
            self._thread = None
        self._tell()

    def _put(self, job: Job) -> threading.Lock:
        """Let `job` be done; a lock that is free afterwards."""
        lock = threading.Lock()
        lock.acquire()
        self._jobs.put((job, lock))
        return lock

    def _tell(self) -> None:
        if self._failures:
            failure, *_ = self._failures
            self._failures.clear()
            raise failure


def _work(jobs: "SimpleQueue[tuple[Job, threading.Lock] | None]", failures: list[BaseException]) -> None:
    while (asked := jobs.get()) is not None:
        job, lock = asked
        try:
            job()
        except BaseException as failure:
            failures.append(failure)
        finally:
            # what it holds may be large
            del asked, job
            lock.release()
