"""`python -O` leaves out asserts, and changes nothing else."""

import ast
from pathlib import Path

SOURCE = Path(__file__).parents[1] / "twin"
HARMLESS = {"isinstance", "len"}


def test_no_assert_has_work_to_do():
    asserts = 0
    for file in SOURCE.rglob("*.py"):
        for node in ast.walk(ast.parse(file.read_text())):
            if not isinstance(node, ast.Assert):
                continue
            asserts += 1
            inside = list(ast.walk(node))
            called = {ast.unparse(part.func) for part in inside if isinstance(part, ast.Call)}
            assert called <= HARMLESS, f"{file}:{node.lineno}"
            assert not any(isinstance(part, ast.NamedExpr | ast.Await | ast.Yield) for part in inside), file
    assert asserts > 10
