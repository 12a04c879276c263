"""`make house`: whether each idea of twin exists once, and how its files read; nothing fails, CI shows it.

What is counted in the Python files of `twin/`:

- types of an idea: those of the names in `IDEAS` that are defined, as class, function or constant of a module.
- glued files: module docstrings of `GLUED` or more titles, as two files leave that were put together. A title is a
  paragraph of one sentence, of `TITLE` letters at most, that is neither indented, nor an item of a list, nor ends in a
  colon.
- participles: functions and methods whose whole name is a participle, a preposition or an adverb; such classes.
- one-word constants: names in capitals without an underscore between words, of modules and classes.
- constants: names in capitals that a module assigns below its first function or class.
- touched: files with a function that is called while `twin.run` runs the paper's experiment, in a process that has run
  it before, so that nothing is compiled or loaded.
- circles: groups of files that import each other, by imports inside functions and for type checkers, too.
- lines.
"""

import ast
import re
import sys
import tempfile
from collections.abc import Iterator, Mapping, Sequence, Set
from pathlib import Path
from types import FrameType
from typing import NamedTuple

REPOSITORY = Path(__file__).parents[1]
EXPERIMENT, LASTING = "fig4_force_position", ("duration_s=1",)
GLUED, TITLE = 3, 160


class Idea(NamedTuple):
    """An idea that should have one type, or few: the names of all types that it has or had.

    Attributes:
        name: of the row.
        before: number of types at commit ab351231.
        asked: number of types that are enough.
        types: names of classes, functions or constants; with a folder in front of it, only there.
    """

    name: str
    before: int
    asked: int
    types: str


IDEAS = (
    Idea(
        "outcomes of a simulation", 14, 8,
        "Run RunOutcome FaultTrial TrialRun FaultOutcome Felt EvidenceRun RunFinding RunResult BranchOutcome "
        "DriveTrial TickPoint tune.WholeRun StepTrial run.Outcome Reaction",
    ),
    Idea(
        "views of a run", 13, 8,
        "PanelRun TracedRun RobotRun RunSeries ReportRun MemoryRun LogRun TrueRun Fig4Run TaskRun Signals _Part _Trace "
        "RunView",
    ),
    Idea("pasts that simulations share", 5, 1, "Trials FeltRuns PastRuns LastPast paired_step_runs Runs"),
    Idea("sample records", 4, 1, "FilterSamples RobotSamples Sample RobotLog"),
    Idea("readers of a command line", 3, 2, "COMMAND_PATTERN Commands cli.ANSWERS"),
    Idea("gates of servers", 2, 1, "Gate OwnPageGate"),
    Idea("lists of hooks", 5, 1, "HOOKS _helpers _witnesses _witness _listeners _of_process"),
)  # fmt: skip
MEASURES = (
    ("functions that are bare participles", 682, 50),
    ("classes that are participles or adverbs", 84, 5),
    ("constants of one word", 1_726, 600),
    (f"glued files: {GLUED} or more titles", 34, 0),
    ("constants below the first definition", 1_173, 300),
    ("files that an experiment touches", 51, 40),
    ("circles between files", 2, 0),
    ("lines of Python", 88_138, 83_500),
)
"""What else is measured, what it was at commit ab351231, and what is asked."""

NOUNS_IN_ED = "seed speed need feed bed shed weed embed exceed proceed succeed bleed breed"
PARTICIPLES = (
    "held made kept said begun led felt spelt meant told known given taken written drawn shown seen built found left "
    "sent met bound woven worn gone done chosen frozen hidden brought caught heard hung laid lent lost paid spoken "
    "stood struck stuck torn thrown understood wound grown fallen fed forgotten sold broken driven redone undone "
    "unread unsaid unseen unbound rebuilt"
)
"""Irregular participles that are not infinitives; the regular ones end in -ed."""
ADVERBS = (
    "of at in on by with to from for beside besides apart alike aside about above across after against along among "
    "around before behind below between beyond during elsewhere otherwise except inside outside near off onto over "
    "past since than through till toward under until unlike up upon via within without here there when where how why "
    "so again anew also else ever never now soon then together ahead away back down forth out"
)
"""Prepositions and adverbs."""


class Measure(NamedTuple):
    """A row of the table."""

    name: str
    before: int
    now: int
    asked: int


class Source(NamedTuple):
    """A module: its file, the lines and the tree of its text."""

    path: Path
    lines: int
    tree: ast.Module


def main() -> None:
    """Print the table, and which types and files the numbers are made of."""
    modules = sources(REPOSITORY / "twin")
    print(f"{'':42}{'before':>8}{'now':>8}{'asked':>8}")
    for row in measures(modules, touched()):
        print(f"{row.name:42}{row.before:8}{row.now:8}{row.asked:8}")
    print()
    for idea in IDEAS:
        print(f"{idea.name}: {', '.join(found(idea, modules)) or 'none'}")
    for name, one in modules.items():
        if len(there := titles(one.tree)) >= GLUED:
            print(f"glued: {name} has {len(there)} titles, such as: {there[1]}")
    for circle in circles({name: imports(name, one.tree, modules) for name, one in modules.items()}):
        print(f"circle: {', '.join(sorted(circle))}")


def measures(modules: Mapping[str, Source], files_touched: int) -> list[Measure]:
    """Every measure of `modules`; `files_touched` is counted elsewhere."""
    named = [kind for one in modules.values() for kind in vague_names(one.tree)]
    now = (
        named.count("function"),
        named.count("class"),
        named.count("constant"),
        sum(len(titles(one.tree)) >= GLUED for one in modules.values()),
        sum(len(late_constants(one.tree)) for one in modules.values()),
        files_touched,
        len(circles({name: imports(name, one.tree, modules) for name, one in modules.items()})),
        sum(one.lines for one in modules.values()),
    )
    return [
        *(Measure(one.name, one.before, len(found(one, modules)), one.asked) for one in IDEAS),
        *(Measure(name, before, count, asked) for (name, before, asked), count in zip(MEASURES, now, strict=True)),
    ]


def sources(package: Path) -> dict[str, Source]:
    """The modules of `package` by their names."""
    modules = {}
    for path in sorted(package.rglob("*.py")):
        text = path.read_text("utf-8")
        parts = (package.name, *path.relative_to(package).with_suffix("").parts)
        name = ".".join(parts).removesuffix(".__init__")
        modules[name] = Source(path, len(text.splitlines()), ast.parse(text))
    return modules


def found(idea: Idea, modules: Mapping[str, Source]) -> list[str]:
    """The types of `idea` that modules define, as MODULE.NAME, in the order of the names."""
    there: dict[str, list[str]] = {}
    for module, one in modules.items():
        for node in one.tree.body:
            for name in _defined(node):
                there.setdefault(name, []).append(f"{module.partition('.')[2]}.{name}")
    parts = [one.rpartition(".") for one in idea.types.split()]
    return [
        path for folder, _, name in parts for path in there.get(name, ()) if not folder or folder in path.split(".")
    ]


def titles(tree: ast.Module) -> list[str]:
    """The paragraphs of a module's docstring that read as titles of files."""
    paragraphs = re.split(r"\n\s*\n", ast.get_docstring(tree) or "")
    texts = [" ".join(one.split()) for one in paragraphs if not one.startswith((" ", "- "))]
    return [one for one in texts if 0 < len(one) <= TITLE and one[-1] != ":" and not re.search(r"[.?!] ", one)]


def vague_names(tree: ast.AST) -> Iterator[str]:
    """Kind of each definition in `tree` whose name has one word that needs its file to be understood."""
    for node in ast.walk(tree):
        if isinstance(node, ast.FunctionDef | ast.AsyncFunctionDef) and _is_vague(node.name):
            yield "function"
        if isinstance(node, ast.ClassDef) and _is_vague(node.name.lower()):
            yield "class"
        if isinstance(node, ast.ClassDef | ast.Module):
            names = (name for one in node.body for name in _assigned(one))
            yield from ("constant" for name in names if re.fullmatch(r"_*[A-Z][A-Z0-9]*", name))


def _is_vague(name: str) -> bool:
    word = name.strip("_")
    regular = word.endswith("ed") and len(word) > 3 and word not in NOUNS_IN_ED.split()
    return not name.startswith("__") and (regular or word in f"{PARTICIPLES} {ADVERBS}".split())


def late_constants(tree: ast.Module) -> list[str]:
    """The constants that a module assigns below its first function or class."""
    bodies = [number for number, node in enumerate(tree.body) if isinstance(node, ast.FunctionDef | ast.ClassDef)]
    return [name for node in tree.body[min(bodies, default=len(tree.body)) :] for name in _assigned(node)
            if name.isupper()]  # fmt: skip


def _defined(node: ast.stmt) -> Sequence[str]:
    """The names that a statement of a module defines."""
    return [node.name] if isinstance(node, ast.FunctionDef | ast.ClassDef) else _assigned(node)


def _assigned(node: ast.stmt) -> list[str]:
    targets = node.targets if isinstance(node, ast.Assign) else [node.target] if isinstance(node, ast.AnnAssign) else []
    return [one.id for target in targets for one in ast.walk(target) if isinstance(one, ast.Name)]


def imports(name: str, tree: ast.Module, modules: Mapping[str, object]) -> set[str]:
    """Those of `modules` that module `name` imports anywhere."""
    paths = set()
    for node in ast.walk(tree):
        if isinstance(node, ast.Import):
            paths |= {alias.name for alias in node.names}
        elif isinstance(node, ast.ImportFrom) and node.module and not node.level:
            # a module of a package, or a name of a module
            whole = {alias: f"{node.module}.{alias.name}" for alias in node.names}
            paths |= {path if path in modules else node.module for path in whole.values()}
    return {one for one in paths if one in modules} - {name}


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

    experiment, run = twin.load(EXPERIMENT, LASTING), twin.run
    with tempfile.TemporaryDirectory() as folder:
        run(experiment, f"{folder}/first")
        sys.setprofile(note)
        try:
            run(experiment, f"{folder}/second")
        finally:
            sys.setprofile(None)
    home = Path(twin.__file__).parent
    return sum(home in Path(name).parents for name in files)


if __name__ == "__main__":
    main()
