"""A mutant is tried against the test files that can notice it, and no others."""

import os
import subprocess
import sys
from pathlib import Path

import pytest

pytest.importorskip("cosmic_ray", reason="the extra mutants, which only make mutants asks for")

from tests.mutants.executed import TestFile, environment, makes_machine_code, noted, noticing, read, write
from tests.mutants.mutant import Mutant, possible_mutants

SOURCE = '''"""A module."""

from twin.kernel.compiled.function import njit


def _at_import():
    return 1


X = _at_import()


@njit(cache=True)
def compiled(x):
    return x + 2


def called(x):
    if x > 3:
        return (
            x
            + 4
        )
    return 5


def not_called():
    return 6
'''


@pytest.fixture
def repository(tmp_path: Path) -> Path:
    path = tmp_path / "twin" / "robot" / "mechanism" / "part.py"
    path.parent.mkdir(parents=True)
    path.write_text(SOURCE)
    (tmp_path / "twin" / "__init__.py").touch()
    (tmp_path / "twin" / "robot" / "__init__.py").touch()
    # a process that knows nothing of the other one's files
    compiled = tmp_path / "twin" / "kernel" / "compiled"
    compiled.mkdir(parents=True)
    (compiled / "function.py").write_text("def njit(**options):\n    return lambda f: f\n")
    return tmp_path


@pytest.fixture
def ran(repository: Path) -> TestFile:
    """Of a test that calls the module with a small number, in a process that is killed thereafter."""
    notes = repository / "notes"
    code = "import os; from twin.robot.mechanism.part import called; called(1); os.kill(os.getpid(), 9)"
    subprocess.run(
        [sys.executable, "-c", code], env={**os.environ, **environment(repository, notes)}, check=False, cwd=repository
    )
    return TestFile(Path("tests/robot/mechanism/test_part.py"), 1.0, *noted(repository, notes))


@pytest.fixture
def numbers(repository: Path) -> dict[str, Mutant]:
    """The first mutant of each number of the source."""
    lines = SOURCE.splitlines()
    found = [mutant for mutant in possible_mutants(repository) if mutant.operator == "core/NumberReplacer"]
    return {lines[mutant.line - 1].split()[-1].rstrip(":"): mutant for mutant in reversed(found)}


@pytest.mark.parametrize(
    ("number", "runs"), {"1": True, "2": True, "3": True, "4": False, "5": True, "6": False}.items()
)
def test_a_test_may_notice_what_it_runs_and_all_compiled_code_that_it_imports(ran, numbers, number, runs):
    assert ran.runs(numbers[number]) is runs


def test_what_runs_while_a_module_is_imported_or_never_seems_to_may_be_in_machine_code(ran, numbers):
    found = [number for number in sorted(numbers) if makes_machine_code(numbers[number], [ran])]
    assert found == ["1", "2", "4", "6"]


def test_what_nobody_seems_to_run_is_tried_against_all_that_import_it(ran, numbers):
    stranger = TestFile(Path("tests/robot/mechanism/test_other.py"), 1.0)
    imports = TestFile(Path("tests/robot/mechanism/test_imports.py"), 1.0, {numbers["6"].file: {1}})
    assert noticing(numbers["3"], [stranger, imports, ran]) == [ran]
    assert noticing(numbers["6"], [stranger, imports, ran]) == [imports, ran]


def test_a_line_in_the_middle_belongs_to_its_statement(numbers):
    assert numbers["4"].statement == range(20, 24)
    assert numbers["3"].statement == range(19, 20)


def test_what_a_test_ran_is_known_in_the_next_session(ran, tmp_path):
    kept = tmp_path / "executed.json"
    assert read(kept) == {}
    write([ran], kept)
    assert read(kept) == {ran.path: ran}
