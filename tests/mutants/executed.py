"""Which lines of the package a test file runs, and so which test files can notice a mutant."""

import json
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass, field
from pathlib import Path

from tests.mutants.mutant import Mutant

TRACER = Path(__file__).parent / "tracer"


@dataclass
class TestFile:
    """A file of tests and what it ran, in its own process and in those that it started.

    Attributes:
        path: of it.
        seconds: it took, with compiling if it was the first, and with the tracer.
        lines: that it ran, by file below the repository; nothing of what is compiled.
        imported: those of them that ran because a module was imported.
    """

    __test__ = False

    path: Path
    seconds: float
    lines: Mapping[Path, set[int]] = field(default_factory=dict)
    imported: Mapping[Path, set[int]] = field(default_factory=dict)

    def runs(self, mutant: Mutant) -> bool:
        """Whether it may notice `mutant`: the statement ran, or, of compiled code, any of the file."""
        lines = self.lines.get(mutant.file, set())
        return bool(lines) if mutant.is_compiled else not lines.isdisjoint(mutant.statement)


def write(files: Iterable[TestFile], path: Path) -> None:
    """Keep what is known of `files` at `path`, whole or not at all."""

    def listed(lines: Mapping[Path, set[int]]) -> dict[str, list[int]]:
        return {str(file): sorted(found) for file, found in lines.items()}

    facts = [[str(file.path), file.seconds, listed(file.lines), listed(file.imported)] for file in files]
    beside = path.with_suffix(".new")
    beside.write_text(json.dumps(facts))
    beside.replace(path)


def read(path: Path) -> dict[Path, TestFile]:
    """What `write` kept at `path`, by test file; nothing if there is no such file."""

    def sets(lines: Mapping[str, list[int]]) -> dict[Path, set[int]]:
        return {Path(file): set(found) for file, found in lines.items()}

    facts = json.loads(path.read_text()) if path.exists() else []
    return {Path(name): TestFile(Path(name), seconds, *map(sets, lines)) for name, seconds, *lines in facts}


def environment(root: Path, notes: Path) -> dict[str, str]:
    """Variables by which the tracer writes to `notes` what runs of the repository at `root`."""
    return {
        "PYTHONPATH": f"{root}:{TRACER}",
        "MUTANTS_SOURCE": str(root / "twin") + "/",
        "MUTANTS_NOTES": str(notes),
    }


def noted(root: Path, notes: Path) -> tuple[dict[Path, set[int]], dict[Path, set[int]]]:
    """Lines that ran by file below `root`, and those that ran while modules were imported."""
    lines: dict[Path, set[int]] = {}
    imported: dict[Path, set[int]] = {}
    for note in notes.read_text().splitlines() if notes.exists() else ():
        name, line, *how = note.split(":")
        for found in (lines, imported) if how else (lines,):
            found.setdefault(Path(name).relative_to(root), set()).add(int(line))
    return lines, imported


def noticing(mutant: Mutant, files: Sequence[TestFile]) -> list[TestFile]:
    """Those of `files` that may notice `mutant`: all that import its file if it seems that nobody runs the place."""
    return [file for file in files if file.runs(mutant)] or [file for file in files if file.lines.get(mutant.file)]


def makes_machine_code(mutant: Mutant, files: Sequence[TestFile]) -> bool:
    """Whether code that is compiled may differ: the place is, ran while modules were imported, or never seemed to run.

    A function that is handed to what compiles it, without a decorator, is not seen to run.
    """
    here = [file.imported.get(mutant.file, set()) for file in files]
    never = not any(file.runs(mutant) for file in files)
    return mutant.is_compiled or never or any(not lines.isdisjoint(mutant.statement) for lines in here)
