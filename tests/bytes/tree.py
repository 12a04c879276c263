"""A tree of the repository in a folder of its own, and the workers that do cases in it.

Both lie in folders with names of the same length, so that texts break their lines at the same places, and nobody edits
a file while it is compared.
"""

import fcntl
import hashlib
import json
import os
import queue
import shutil
import subprocess
import sys
import tarfile
import threading
from collections.abc import Callable, Iterable
from dataclasses import asdict
from io import BytesIO
from pathlib import Path
from typing import Any

from tests.bytes.case import Case

REPOSITORY = Path(__file__).parents[2]
ENVIRONMENT = {
    "COLUMNS": "80", "LC_ALL": "C.UTF-8", "MPLBACKEND": "Agg", "NO_COLOR": "1", "OMP_NUM_THREADS": "1",
    "OPENBLAS_NUM_THREADS": "1", "PYTHONHASHSEED": "0", "TERM": "dumb", "TZ": "UTC",
}  # fmt: skip
"""By which a command says the same everywhere."""
UNSET = ("NUMBA_CACHE_DIR", "PYTHONDONTWRITEBYTECODE", "PYTHONSAFEPATH")
"""What would let one tree use what the other compiled, or neither keep anything."""
BOOT = (
    "import sys; sys.path.insert(0, {root!r}); from tests.bytes.worker import main; sys.path.remove({root!r}); main()"
)
"""Workers are of the working tree; what they drive is found by PYTHONPATH."""


class Tree:
    """The files of `commit`, or of the working tree if it is "", in a folder of `home` that stays from run to run.

    So Python and the twin find again what they compiled. Nobody else uses it until it is closed.
    """

    def __init__(self, home: Path, commit: str):
        known_by = commit or str(REPOSITORY)
        self._folder = home / hashlib.sha256(known_by.encode()).hexdigest()[:12]
        self.root = self._folder / "tree"
        self._folder.mkdir(parents=True, exist_ok=True)
        self._lock = open(self._folder / "lock", "w")  # noqa: SIM115
        fcntl.flock(self._lock, fcntl.LOCK_EX)
        if commit:
            if not self.root.exists():
                _extract(commit, self.root)
        else:
            _follow(self.root)

    def close(self) -> None:
        """Let others use it."""
        for left in self._folder.glob("case-*"):
            shutil.rmtree(left, ignore_errors=True)
        self._lock.close()

    def do(self, cases: Iterable[Case], jobs: int, kept: str, done: Callable[[Case, dict[str, Any]], None]) -> None:
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
                # which closes what it reads, so that it ends
                worker.communicate()

        threads = [threading.Thread(target=work) for _ in range(jobs)]
        for thread in threads:
            thread.start()
        for thread in threads:
            thread.join()

    def _worker(self, kept: str) -> "subprocess.Popen[str]":
        command = [sys.executable, "-P", "-c", BOOT.format(root=str(REPOSITORY)), str(self.root), kept]
        inherited = {name: value for name, value in os.environ.items() if name not in UNSET}
        env = inherited | ENVIRONMENT | {"PYTHONPATH": str(self.root)}
        return subprocess.Popen(
            command, cwd=self._folder, env=env, text=True, stdin=subprocess.PIPE, stdout=subprocess.PIPE
        )


def _asked(worker: "subprocess.Popen[str]", case: Case) -> dict[str, Any]:
    """What `worker` came to with `case`; that it ended, if it did."""
    assert worker.stdin and worker.stdout
    try:
        worker.stdin.write(json.dumps(asdict(case)) + "\n")
        worker.stdin.flush()
        answer = worker.stdout.readline()
    except BrokenPipeError:
        answer = ""
    if answer:
        return json.loads(answer)
    return {"ended": f"the process ended with exit code {worker.wait()}"}


def _extract(commit: str, root: Path) -> None:
    """The files of `commit` at `root`, whole or not at all."""
    beside = root.with_name("unfinished")
    shutil.rmtree(beside, ignore_errors=True)
    with tarfile.open(fileobj=BytesIO(_git("archive", commit))) as archive:
        archive.extractall(beside, filter="tar")
    beside.rename(root)


def _follow(root: Path) -> None:
    """Make the files at `root` those of the working tree; what is the same is left alone, as what is compiled of it."""
    listed = _git("ls-files", "-z", "--cached", "--others", "--exclude-standard").decode().split("\0")
    names = {name for name in listed if name and (REPOSITORY / name).is_file()}
    for folder, _, files in os.walk(root, topdown=False):
        place = Path(folder)
        if "__pycache__" not in place.parts:
            for name in files:
                if str((place / name).relative_to(root)) not in names:
                    (place / name).unlink()
            # a folder without a file would be a package still
            if {entry.name for entry in place.iterdir()} <= {"__pycache__"}:
                shutil.rmtree(place)
    for name in names:
        ours, theirs = REPOSITORY / name, root / name
        now = ours.stat()
        if not theirs.exists() or (theirs.stat().st_mtime_ns, theirs.stat().st_size) != (now.st_mtime_ns, now.st_size):
            theirs.parent.mkdir(parents=True, exist_ok=True)
            shutil.copy2(ours, theirs)


def _git(*words: str) -> bytes:
    return subprocess.run(["git", *words], cwd=REPOSITORY, check=True, capture_output=True).stdout
