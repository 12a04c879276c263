"""A worktree in which mutants are tried: its own source, its own compiled code, nothing of the one in use."""

import ast
import os
import shutil
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
        self.root, self.compiled, self._warm = root / "source", root / "compiled", root / "warm"
        self._repository, self._touched = repository, time.time()
        self._git("worktree", "add", "--quiet", "--detach", str(self.root))
        self._importers = _importers(self.root)

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
        shutil.copytree(self.compiled, self._warm)
        return time.monotonic() - begin

    def tried(self, mutant: Mutant, timeout: float) -> str:
        """What became of `mutant`: "killed", "survived" or "timed out", which counts as killed.

        Its own test file runs first, then those of its room, then the laws; the first that fails ends it.
        """
        file = self.root / mutant.file
        source = file.read_text()
        stale = [f"{name.stem}." for name in self._dependents(mutant.file)]
        try:
            self._drop(stale)
            self._write(file, mutant.applied(source))
            own = self.root / "tests" / mutant.room / f"test_{mutant.file.stem}.py"
            return self._tested([*([own] if own.exists() else []), *self._tests((mutant.room,))], timeout)
        finally:
            self._write(file, source)
            self._drop(stale)
            self._restore(stale)

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
        """Write `source` with a time of its own: Python and numba tell versions of a file by time and size."""
        file.write_text(source)
        self._touched += 1
        os.utime(file, (self._touched, self._touched))

    def _dependents(self, file: Path) -> set[Path]:
        """Files whose compiled code may hold that of `file`: all that import it, however far away."""
        found, new = {file}, {file}
        while new:
            new = {importer for name in new for importer in self._importers.get(name, ())} - found
            found |= new
        return found

    def _drop(self, stems: list[str]) -> None:
        for path in self.compiled.rglob("*.nb*"):
            if path.name.startswith(tuple(stems)):
                path.unlink(missing_ok=True)

    def _restore(self, stems: list[str]) -> None:
        for path in self._warm.rglob("*.nb*"):
            if path.name.startswith(tuple(stems)):
                shutil.copy2(path, self.compiled / path.relative_to(self._warm))

    def _git(self, *words: str) -> None:
        subprocess.run(["git", *words], cwd=self._repository, check=True)


def _importers(root: Path) -> dict[Path, set[Path]]:
    """By file, the files below `root`/twin that import it."""
    importers: dict[Path, set[Path]] = {}
    for path in (root / "twin").rglob("*.py"):
        for node in ast.walk(ast.parse(path.read_text())):
            modules = []
            if isinstance(node, ast.ImportFrom) and node.module:
                modules = [node.module, *(f"{node.module}.{name.name}" for name in node.names)]
            elif isinstance(node, ast.Import):
                modules = [name.name for name in node.names]
            for module in modules:
                name = Path(*module.split(".")).with_suffix(".py")
                if (root / name).exists():
                    importers.setdefault(name, set()).add(path.relative_to(root))
    return importers
