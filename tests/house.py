"""`make house`: how large the house is, and how its rooms hang together; nothing fails, CI shows it.

What is counted, and how:

- lines, statements: of the Python files of `twin/`, which is what the wheel imports; docstrings are no statements.
- files, and the median of their lines: those that are not called `__init__.py`.
- one importer: modules that exactly one other module of `twin/` imports, wherever in it the import stands.
- touched: files of `twin/` with a function that is called while `twin.run` runs the paper's experiment, in a process
  that has run it before, so that nothing is compiled or loaded.
- circles: groups of files that import each other, by imports inside functions and for type checkers, too.
- rooms: folders and modules at the top of `twin/` but `__init__` and `__main__`; an arrow leads from each to those that
  it imports.
"""

import ast
import statistics
import sys
import tempfile
from collections.abc import Iterator, Mapping, Set
from pathlib import Path
from types import FrameType
from typing import NamedTuple

REPOSITORY = Path(__file__).parents[1]
EXPERIMENT, LASTING = "fig4_force_position", ("duration_s=1",)
DOCUMENTED = (ast.Module, ast.ClassDef, ast.FunctionDef, ast.AsyncFunctionDef)


ASKED = (
    ("lines of Python", 70_997, "at most 62,680"),
    ("statements", 37_275, "32,600"),
    ("files without __init__", 668, "at most 320"),
    ("median of their lines", 92, "150 or more"),
    ("modules with one importer", 187, "40"),
    ("files that an experiment touches", 94, "28"),
    ("circles between files", 3, "0"),
    ("folders and modules at the top", 22, "at most 10"),
    ("arrows between them", 103, "at most 80"),
)
"""What is measured, what it was at commit 2e07c914 by this count, and what is asked."""


class Measure(NamedTuple):
    """A row of the table."""

    name: str
    before: int
    now: int
    asked: str


class Source(NamedTuple):
    """A module: its file, the lines and the tree of its text."""

    path: Path
    lines: int
    tree: ast.Module


def main() -> None:
    """Print the table."""
    print(f"{'':42}{'before':>8}{'now':>8}  asked")
    for row in measures(REPOSITORY / "twin", touched()):
        print(f"{row.name:42}{row.before or '':>8}{row.now or '-':>8}  {row.asked}")


def measures(package: Path, files_touched: int) -> list[Measure]:
    """Every measure of the `package`; `files_touched` is counted elsewhere."""
    modules = sources(package)
    arrows = {name: imports(name, one.tree, modules) for name, one in modules.items()}
    bodies = [name for name, one in modules.items() if one.path.name != "__init__.py"]
    importers = {name: sum(name in targets for targets in arrows.values()) for name in bodies}
    room = {name: name.split(".")[1] if "." in name else "" for name in modules}
    # the package itself is no room: who imports it asks for a version or a public name
    between = {(room[a], room[b]) for a in arrows for b in arrows[a]}
    now = (
        sum(one.lines for one in modules.values()),
        sum(statements(one.tree) for one in modules.values()),
        len(bodies),
        round(statistics.median(modules[name].lines for name in bodies)),
        sum(count == 1 for count in importers.values()),
        files_touched,
        len(circles(arrows)),
        len(set(room.values()) - {"", "__main__"}),
        sum(a != b and "" not in (a, b) for a, b in between),
    )
    return [Measure(name, before, count, asked) for (name, before, asked), count in zip(ASKED, now, strict=True)]


def sources(package: Path) -> dict[str, Source]:
    """The modules of `package` by their names."""
    found = {}
    for path in sorted(package.rglob("*.py")):
        text = path.read_text("utf-8")
        parts = (package.name, *path.relative_to(package).with_suffix("").parts)
        name = ".".join(parts).removesuffix(".__init__")
        found[name] = Source(path, len(text.splitlines()), ast.parse(text))
    return found


def statements(tree: ast.Module) -> int:
    """Statements in `tree`; docstrings are none."""
    nodes = list(ast.walk(tree))
    documented = sum(isinstance(node, DOCUMENTED) and ast.get_docstring(node, False) is not None for node in nodes)
    return sum(isinstance(node, ast.stmt) for node in nodes) - documented


def imports(name: str, tree: ast.Module, modules: Mapping[str, object]) -> set[str]:
    """Those of `modules` that module `name` imports anywhere."""
    found = set()
    for node in ast.walk(tree):
        if isinstance(node, ast.Import):
            found |= {alias.name for alias in node.names}
        elif isinstance(node, ast.ImportFrom) and node.module and not node.level:
            # a module of a package, or a name of a module
            whole = {alias: f"{node.module}.{alias.name}" for alias in node.names}
            found |= {path if path in modules else node.module for path in whole.values()}
    return {one for one in found if one in modules} - {name}


def circles(arrows: Mapping[str, Set[str]]) -> list[set[str]]:
    """Groups of more than one name each of which leads to every other."""
    ahead = {name: set(_reached(arrows, name)) for name in arrows}
    groups = {frozenset(other for other in ahead[name] if name in ahead[other]) for name in arrows}
    return [set(group) for group in groups if len(group) > 1]


def _reached(arrows: Mapping[str, Set[str]], start: str) -> Iterator[str]:
    """What arrows lead to from `start`, over any number of others."""
    seen: set[str] = set()
    waiting = [start]
    while waiting:
        for name in arrows[waiting.pop()] - seen:
            seen.add(name)
            waiting.append(name)
            yield name


def touched() -> int:
    """How many files of the twin have a function that is called while `twin.run` runs an experiment."""
    import twin

    files: set[str] = set()

    def note(frame: FrameType, event: str, _: object) -> None:
        if event == "call":
            files.add(frame.f_code.co_filename)

    experiment = twin.load(EXPERIMENT, LASTING)
    with tempfile.TemporaryDirectory() as folder:
        twin.run(experiment, f"{folder}/first")
        sys.setprofile(note)
        try:
            twin.run(experiment, f"{folder}/second")
        finally:
            sys.setprofile(None)
    home = Path(twin.__file__).parent
    return sum(home in Path(name).parents for name in files)


if __name__ == "__main__":
    main()
