"""What is used of numba's insides does what it is used for, and stands in one file."""

import gc
import re
import tomllib
from importlib.metadata import version
from pathlib import Path

import numba
import numpy as np
from packaging.requirements import Requirement
from packaging.version import Version

from twin.kernel.compiled import function as lanes
from twin.kernel.compiled import function as memory
from twin.kernel.compiled.function import Function, njit
from twin.kernel.compiled.numba_internals import inner_module

DOUBLE = numba.float64(numba.float64)


def twice(x: float) -> float:
    return 2.0 * x


def test_a_module_has_the_inner_function_and_what_it_calls():
    inner, often = Function(twice), gc.get_threshold()

    def outer(x: float) -> float:
        return inner(x) + 1.0

    name, text = inner_module(DOUBLE, outer)
    assert f"@{name}(" in text and "twice" in text
    assert gc.get_threshold() == often


def test_numba_asks_a_name_for_its_type():
    assert type(Function(twice)._numba_type_).__name__ == "Dispatcher"


def test_what_is_registered_or_declared_is_known_to_what_is_compiled():
    @njit()
    def calls(a, b, to):
        memory.copy(to, to, 0)
        return (lanes.three(a, b, a) + lanes.three(b, b, b))[0]

    assert calls.dispatcher(1.0, 2.0, np.zeros(1).ctypes.data) == 3.0


def test_no_other_file_looks_inside_numba(root: Path):
    inside = re.compile(r"numba\.core|cgutils|_numba_type_|_wrapper_name|_final_module")
    files = [path for path in (root / "twin").rglob("*.py") if inside.search(path.read_text())]
    assert [path.name for path in files] == ["numba_internals.py"]


def test_no_version_is_installed_that_was_never_tried(root: Path):
    table = tomllib.loads((root / "pyproject.toml").read_text())
    (numba_asked,) = (Requirement(line) for line in table["project"]["dependencies"] if line.startswith("numba"))
    tried = Version(version("numba"))
    assert tried in numba_asked.specifier
    assert f"{tried.major}.{tried.minor + 1}" not in numba_asked.specifier
