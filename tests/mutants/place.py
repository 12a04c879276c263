"""A tree in which mutants are tried: its own source, its own compiled code, nothing of the one in use.

It stays from session to session, with what its tests ran and compiled.
"""

import ast
import os
import shutil
import subprocess
import sys
import tarfile
import time
from collections.abc import Iterable, Mapping, Sequence
from io import BytesIO
from pathlib import Path

from tests.mutants.executed import TestFile, environment, makes_machine_code, noted, noticing, read, write
from tests.mutants.mutant import Mutant

PATIENCE = 3.0
"""A mutant is given this many times what its tests took without one: an endless loop is noticed, too."""
BEGINNING, COMPILING = 20.0, 120.0
"""Seconds that tests are given beside that, with all compiled code at hand and without."""
NOTHING_TO_RUN = 5
"""Exit code of pytest where all tests of a file are left out."""


class Place:
    """The files of a commit in a folder that stays.

    Args:
        repository: that has the commit.
        folder: what is kept, by this one alone.
        commit: of the source.

    Attributes:
        root: folder of the source.
        tests: files of tests that mutants are tried against, by folder of tests/; `warm` finds them.
    """

    def __init__(self, repository: Path, folder: Path, commit: str):
        self.root = folder / "source"
        # below the package no name has the hash of the source in it, which every mutant changes
        self._compiled = self.root / "twin" / "__pycache__" / "native" / "warm"
        self._cache, self._warm, self._notes = folder / "cache", folder / "warm", folder / "notes"
        self._executed = folder / "executed.json"
        self._known = read(self._executed)
        self._touched = time.time()
        self.tests: dict[str, list[TestFile]] = {}
        files = subprocess.run(["git", "archive", commit], cwd=repository, check=True, capture_output=True).stdout
        with tarfile.open(fileobj=BytesIO(files)) as archive:
            # over a mutant that an earlier session left; with the time of the commit, so what was compiled stays good
            archive.extractall(self.root, filter="tar")
        self._importers = _importers(self.root)
        for part in (self._compiled, self._cache):
            part.mkdir(0o700, parents=True, exist_ok=True)
        if not self._warm.exists():
            self._keep()

    def warm(self, folders: Iterable[str]) -> float:
        """Compile and run what is not known yet of all tests in `folders` of tests/; return the seconds it took.

        Raises:
            RuntimeError: a test fails without any mutant.
        """
        self._make_ready(())
        begin = time.monotonic()
        for name in folders:
            files = sorted((self.root / "tests" / name).rglob("test_*.py"))
            self.tests[name] = [self._known.get(path) or self._traced(path) for path in files]
        return time.monotonic() - begin

    def tried(self, mutant: Mutant, folder: str) -> str:
        """What became of `mutant`: "killed", "survived" or "timed out", which counts as killed.

        Of the tests in `folder` of tests/ those run that can notice it: its own test file first, then the fastest
        first; the first that fails ends it.
        """
        compiles = makes_machine_code(mutant, [test for tests in self.tests.values() for test in tests])
        file = self.root / mutant.file
        source, found = file.read_text(), file.stat()
        try:
            self._make_ready(self._dependents(mutant.file) if compiles else ())
            self._write(file, mutant.applied(source))
            for tests in self._noticing(mutant, folder):
                timeout = PATIENCE * ((COMPILING if compiles else BEGINNING) + sum(test.seconds for test in tests))
                outcome = self._tested([test.path for test in tests], timeout) if tests else "survived"
                if outcome != "survived":
                    return outcome
            return "survived"
        finally:
            file.write_text(source)
            # what was compiled without the mutant stays good
            os.utime(file, ns=(found.st_atime_ns, found.st_mtime_ns))

    def _traced(self, path: Path) -> TestFile:
        """What the tests in `path` run, unchanged; it is kept with what they compiled."""
        self._notes.unlink(missing_ok=True)
        begin = time.monotonic()
        if self._tested([path], None, environment(self.root, self._notes)) != "survived":
            raise RuntimeError(f"{path}: fails without a mutant")
        test = TestFile(path, time.monotonic() - begin, *noted(self.root, self._notes))
        self._keep()
        self._known[path] = test
        write(self._known.values(), self._executed)
        print(f"{path.relative_to(self.root)}: {test.seconds:.0f} s", flush=True)
        return test

    def _noticing(self, mutant: Mutant, folder: str) -> tuple[list[TestFile], list[TestFile]]:
        """Test files in `folder` that can notice `mutant`: its own, which is there or not, and the others."""
        own = self.root / "tests" / mutant.room / f"test_{mutant.file.stem}.py"
        able = sorted(noticing(mutant, self.tests[folder]), key=lambda test: test.seconds)
        return [test for test in able if test.path == own], [test for test in able if test.path != own]

    def _tested(self, tests: Sequence[Path], timeout: float | None, variables: Mapping[str, str] | None = None) -> str:
        command = [sys.executable, "-m", "pytest", "-x", "-q", "-m", "not endurance", "-p", "no:cacheprovider"]
        places = {"NUMBA_CACHE_DIR": str(self._compiled), "TWIN_CACHE": str(self._cache)}
        process = subprocess.Popen(
            [*command, *map(str, tests)],
            cwd=self.root,
            env={**os.environ, "PYTHONPATH": str(self.root), **places, **(variables or {})},
            stdout=subprocess.DEVNULL,
            stderr=subprocess.DEVNULL,
            start_new_session=True,
        )
        try:
            return "survived" if process.wait(timeout) in (0, NOTHING_TO_RUN) else "killed"
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

    def _make_ready(self, stale: Iterable[Path]) -> None:
        """Make the caches as `_keep` found them, without the compiled code of the files in `stale`."""
        # objects are named after the module, what numba keeps after the file alone
        names = {".".join(name.with_suffix("").parts[1:]) for name in stale} | {name.stem for name in stale}
        for folder in (self._compiled, self._cache):
            shutil.rmtree(folder)
        # files there are replaced, never written into
        shutil.copytree(
            self._warm / self._compiled.name,
            self._compiled,
            copy_function=os.link,
            ignore=lambda _, files: [file for file in files if _source(file) in names],
        )
        shutil.copytree(self._warm / self._cache.name, self._cache)

    def _keep(self) -> None:
        """Make what the caches hold what they begin with."""
        beside = self._warm.with_name("unfinished")
        shutil.rmtree(beside, ignore_errors=True)
        shutil.copytree(self._compiled, beside / self._compiled.name, copy_function=os.link)
        shutil.copytree(self._cache, beside / self._cache.name)
        shutil.rmtree(self._warm, ignore_errors=True)
        beside.rename(self._warm)


def _source(compiled: str) -> str:
    """The module or file that a file of compiled code is named after: it is followed by function and form."""
    if ".nb" in compiled:
        return compiled.split(".")[0]
    return compiled.rsplit("-", 1)[0].rpartition(".")[0]


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
