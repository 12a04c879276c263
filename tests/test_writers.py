"""One place writes files: whoever else opened one for writing could leave half of it, or end in a traceback."""

import ast
from collections.abc import Iterator
from pathlib import Path

import pytest

ALONE = {
    "kernel/atomic_write.py": "the place",
    "kernel/recording/writer.py": "a recording grows, is readable before it is finished, and renamed then",
    "report/explore/server.py": "a token in the cache",
    "studies/sweep/rows.py": "rows are only ever appended to",
    "kernel/cache_folder.py": "a cache",
    "kernel/fmi/unpacked.py": "a cache",
    "kernel/compiled/store.py": "a cache",
    "kernel/recording/folder.py": "the folder of a run must be new, and the file in it grows",
    "kernel/process/child.py": "pipes to the guard",
    "cli/streams.py": "standard streams",
    "report/page/picture.py": "what one process hands to another, in a folder of its own that goes with the page",
}
"""Those who write by themselves, and why."""
METHODS = {"write_text", "write_bytes", "savefig", "mkdir", "makedirs", "touch", "symlink_to", "write_table", "tofile"}
BESIDE = {"beside", "file"}
"""What `written` yields, and a buffer in memory."""


def writing(tree: ast.Module) -> Iterator[ast.Call]:
    """Calls that write to the disk under a name of their own choice."""
    for call in (node for node in ast.walk(tree) if isinstance(node, ast.Call)):
        method = isinstance(call.func, ast.Attribute)
        name = call.func.attr if isinstance(call.func, ast.Attribute) else getattr(call.func, "id", "")
        names = {node.id for node in ast.walk(call) if isinstance(node, ast.Name)}
        modes = {arg.value for arg in (*call.args, *(k.value for k in call.keywords)) if isinstance(arg, ast.Constant)}
        if method and name in METHODS and not names & BESIDE:
            yield call
        if name in ("open", "fdopen") and not names & BESIDE:
            if any(isinstance(mode, str) and mode[:1] in ("w", "a", "x") and len(mode) < 4 for mode in modes):
                yield call
            if any(isinstance(node, ast.Attribute) and node.attr.startswith("O_CREAT") for node in ast.walk(call)):
                yield call


@pytest.mark.slow
def test_nobody_else_writes_files(root: Path):
    found = {
        f"{path.relative_to(root / 'twin').as_posix()}:{call.lineno}"
        for path in (root / "twin").rglob("*.py")
        for call in writing(ast.parse(path.read_text(encoding="utf-8")))
        if path.relative_to(root / "twin").as_posix() not in ALONE
    }
    assert found == set()


@pytest.mark.parametrize(
    "text",
    [
        'Path("x").write_text("y")', 'open("x", "w")', 'path.open("ab")', 'path.open(mode="x")', "figure.savefig(path)",
        "os.open(path, os.O_CREAT)", "pq.write_table(table, path)", "folder.mkdir()",
    ],
)  # fmt: skip
def test_what_writes_is_known(text: str):
    assert list(writing(ast.parse(text)))


def test_those_who_may_are_there(root: Path):
    assert [name for name in ALONE if not (root / "twin" / name).exists()] == []
