"""A worktree in which mutants are tried: its own source, its own compiled code, nothing of the one in use."""

import os
import subprocess
import sys
import time
from collections.abc import Iterable
from pathlib import Path

from tests.mutants.mutant import Mutant


class Place:
    """A worktree at the commit that is checked out.

    Attributes:
        root: its folder.
        compiled: folder of its compiled code.
    """

    def __init__(self, repository: Path, root: Path):
        """Make the worktree below `root`, an empty folder."""
        self.root, self.compiled = root / "source", root / "compiled"
        self._repository, self._touched = repository, time.time()
        self._git("worktree", "add", "--quiet", "--detach", str(self.root))

    def close(self) -> None:
        """Remove the worktree."""
        self._git("worktree", "remove", "--force", str(self.root))

    def warm(self, rooms: Iterable[str]) -> float:
        """Compile and run all that mutants of `rooms` are tried against, unchanged; return the seconds it took.

        Raises:
            RuntimeError: a test fails without any mutant.
        """
        begin = time.monotonic()
        outcome = self._tested(self._tests(rooms), timeout=None)
        if outcome != "survived":
            raise RuntimeError(f"{self.root}: tests fail without a mutant")
        return time.monotonic() - begin

    def tried(self, mutant: Mutant, timeout: float) -> str:
        """What became of `mutant`: "killed", "survived" or "timed out", which counts as killed.

        Its own test file runs first, then those of its room, then the laws; the first that fails ends it.
        """
        file = self.root / mutant.file
        source = file.read_text()
        try:
            self._write(file, mutant.applied(source))
            own = self.root / "tests" / mutant.room / f"test_{mutant.file.stem}.py"
            return self._tested([*([own] if own.exists() else []), *self._tests((mutant.room,))], timeout)
        finally:
            self._write(file, source)

    def _tests(self, rooms: Iterable[str]) -> list[Path]:
        return [self.root / "tests" / room for room in (*rooms, "laws")]

    def _tested(self, tests: list[Path], timeout: float | None) -> str:
        command = [sys.executable, "-m", "pytest", "-x", "-q", "-m", "not endurance", "-p", "no:cacheprovider"]
        environment = {**os.environ, "PYTHONPATH": str(self.root), "NUMBA_CACHE_DIR": str(self.compiled)}
        process = subprocess.Popen(
            [*command, *map(str, tests)],
            cwd=self.root,
            env=environment,
            stdout=subprocess.DEVNULL,
            stderr=subprocess.DEVNULL,
            start_new_session=True,
        )
        try:
            return "killed" if process.wait(timeout) else "survived"
        except subprocess.TimeoutExpired:
            return "timed out"
        finally:
            # what the tests started goes with them
            subprocess.run(["pkill", "-KILL", "-g", str(process.pid)], check=False)
            process.wait()

    def _write(self, file: Path, source: str) -> None:
        """Write `source` with a time of its own: Python tells versions of a file by time and size."""
        file.write_text(source)
        self._touched += 1
        os.utime(file, (self._touched, self._touched))

    def _git(self, *words: str) -> None:
        subprocess.run(["git", *words], cwd=self._repository, check=True)
