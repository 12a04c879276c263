"""A tree of the repository in a folder of its own, and the workers that do cases in it.

Both trees lie in folders with names of the same length, so that texts break their lines at the same places; and a file
that is edited meanwhile is not half of one and half of the other.
"""

import json
import os
import queue
import shutil
import subprocess
import sys
import tarfile
import tempfile
import threading
from collections.abc import Callable, Iterable
from dataclasses import asdict
from io import BytesIO
from pathlib import Path
from typing import Any

from tests.bytes.cases import Case

REPOSITORY = Path(__file__).parents[2]
ENVIRONMENT = {
    "COLUMNS": "80", "LC_ALL": "C.UTF-8", "MPLBACKEND": "Agg", "NO_COLOR": "1", "OMP_NUM_THREADS": "1",
    "OPENBLAS_NUM_THREADS": "1", "PYTHONHASHSEED": "0", "TERM": "dumb", "TZ": "UTC",
}  # fmt: skip
"""By which a command says the same everywhere."""
BOOT = "import sys; sys.path.insert(0, {root!r}); from tests.bytes.worker import main; sys.path.remove({root!r}); main()"
"""Workers are of the working tree; what they drive is found by PYTHONPATH."""


class Tree:
    """A copy of the files of `commit`, or of the working tree if it is ""."""

    def __init__(self, commit: str):
        # the same length, whichever
        self._folder = Path(tempfile.mkdtemp(prefix="bytes-"))
        self.root = self._folder / "tree"
        if commit:
            packed = _git("archive", commit)
            with tarfile.open(fileobj=BytesIO(packed)) as archive:
                archive.extractall(self.root, filter="tar")
        else:
            for name in _git("ls-files", "-z", "--cached", "--others", "--exclude-standard").decode().split("\0"):
                if name and (REPOSITORY / name).is_file():
                    (self.root / name).parent.mkdir(parents=True, exist_ok=True)
                    shutil.copy2(REPOSITORY / name, self.root / name)

    def close(self) -> None:
        shutil.rmtree(self._folder, ignore_errors=True)

    def do(
        self, cases: Iterable[Case], jobs: int, kept: str, done: Callable[[Case, dict[str, Any]], None]
    ) -> None:
        """Do `cases` in `jobs` workers, and say `done` of each with what it came to.

        Args:
            kept: folder in which what they leave is kept; "" for none.
        """
        waiting: queue.SimpleQueue[Case] = queue.SimpleQueue()
        for case in cases:
            waiting.put(case)
        lock = threading.Lock()

        def work() -> None:
            worker = None
            while True:
                try:
                    case = waiting.get_nowait()
                except queue.Empty:
                    break
                worker = worker or self._worker(kept)
                found = _asked(worker, case)
                if worker.poll() is not None:
                    worker = None
                with lock:
                    done(case, found)
            if worker:
                worker.stdin.close()
                worker.wait()

        threads = [threading.Thread(target=work) for _ in range(jobs)]
        for thread in threads:
            thread.start()
        for thread in threads:
            thread.join()

    def _worker(self, kept: str) -> "subprocess.Popen[str]":
        command = [sys.executable, "-P", "-c", BOOT.format(root=str(REPOSITORY)), str(self.root), kept]
        env = os.environ | ENVIRONMENT | {"PYTHONPATH": str(self.root)}
        return subprocess.Popen(
            command, cwd=self._folder, env=env, text=True, stdin=subprocess.PIPE, stdout=subprocess.PIPE
        )


def _asked(worker: "subprocess.Popen[str]", case: Case) -> dict[str, Any]:
    """What `worker` came to with `case`; that it ended, if it did."""
    try:
        worker.stdin.write(json.dumps(asdict(case)) + "\n")
        worker.stdin.flush()
        answer = worker.stdout.readline()
    except BrokenPipeError:
        answer = ""
    if answer:
        return json.loads(answer)
    return {"ended": f"the process ended with exit code {worker.wait()}"}


def _git(*words: str) -> bytes:
    return subprocess.run(["git", *words], cwd=REPOSITORY, check=True, capture_output=True).stdout
