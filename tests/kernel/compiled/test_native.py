"""Machine code that is kept, found again and entered from Python; what numba sees of the names it is written with."""

import itertools
import math
import platform
import subprocess
import sys
import threading
from collections.abc import Callable, Iterator
from pathlib import Path

import llvmlite.binding as llvm
import numpy as np
import pytest

from twin.kernel.compiled import machine, store
from twin.kernel.compiled.function import Function, carray, njit
from twin.kernel.compiled.native import Entry, Native, address_of
from twin.kernel.cosim.component import doubles_at
from twin.kernel.errors import InputRefused
from twin.kernel.process.shared_memory import load

PAIR = np.dtype([("a", "f8"), ("b", "f8")])
_numbers = itertools.count()


@njit(cache=False, inline="always")
def doubled(x):
    return 2.0 * x


@njit(cache=False)
def summed(address, count):
    values, total = carray(doubles_at(address), count), 0.0
    for value in values:
        total += doubled(value)
    return total


@pytest.fixture
def place(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    """An empty store."""
    folder = tmp_path / "objects"
    folder.mkdir(0o700)
    monkeypatch.setattr(store, "object_folder", lambda: folder)
    return folder


def ours(function: Callable) -> Callable:
    """`function` with a name that no other test has."""
    function.__qualname__ = f"{next(_numbers)}"
    return function


def test_what_stands_for_numbas_names_is_compiled_as_those_are():
    values = np.array([1.0, 2.5, -4.0])
    assert summed(values.ctypes.data, 3) == 2.0 * values.sum() == summed.py_func.__globals__["doubled"](values.sum())


def test_the_twin_calls_the_source_of_what_is_compiled_and_numba_is_not_imported():
    code = "import sys; from twin.robot.mechanism.statics import load_torque as f"
    code += "; print(f(2.0, 3.0, 0.5, 1.0), 'numba' in sys.modules)"
    done = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=True)
    assert done.stdout.split() == ["3.0", "False"]


def test_python_enters_with_numbers_and_arrays_and_gets_numbers(place: Path):
    whole = Entry("int", ("int", "int"), ours(lambda a, b: a - b))
    real = Entry("double", ("double", "doubles"), ours(lambda a, values: a * values[1]))

    def fill(pair, values):
        values[0], values[1] = pair.a, pair.b

    nothing = Entry("nothing", (PAIR, "doubles"), ours(fill))
    values = np.zeros(2)
    assert whole(3, 5) == -2 and whole(-(1 << 62), 1) == -(1 << 62) - 1
    assert nothing(np.array([(1.5, -2.5)], dtype=PAIR), values) is None
    assert values.tolist() == [1.5, -2.5]
    assert real(2.0, values) == -5.0


def test_it_is_found_again_by_another_process_and_nothing_is_compiled_then(place: Path, monkeypatch):
    first = Native("double", ("double",), ours(lambda x: math.sin(x) + x))
    assert first.address
    monkeypatch.setattr(machine, "_loaded", set())
    monkeypatch.setattr(Native, "emit_object", lambda *asked: pytest.fail("compiled again"))
    assert Native("double", ("double",), first.function).has_code
    assert not Native("double", ("double", "double"), first.function).has_code


def test_what_is_built_into_something_else_is_not_compiled_once_more(place: Path, monkeypatch: pytest.MonkeyPatch):
    function = ours(lambda x: math.sin(x) + 2.0 * x)
    native = Native("double", ("double",), function)
    assert native.address
    monkeypatch.setattr("twin.kernel.compiled.native.inner_module", lambda *asked: pytest.fail("compiled again"))
    kept = Native("double", ("double",), function).module("another_name")
    assert kept.symbol == "another_name" and kept.inner in kept.text
    # what was damaged is compiled anew
    (file,) = place.glob("*.ll")
    file.write_bytes(file.read_bytes()[:-1])
    with pytest.raises(pytest.fail.Exception, match="compiled again"):
        Native("double", ("double",), function).module("another_name")


def test_a_function_of_a_user_is_kept_and_one_that_has_no_file_is_not(place: Path):
    scope: dict[str, Callable] = {}
    exec("def f(x): return x + 1.0", {"__name__": "nowhere"}, scope)
    assert Native("double", ("double",), scope["f"]).address
    assert not list(place.iterdir())
    assert Native("double", ("double",), lambda x: x + 1.0).address
    assert len(list(place.glob("tests.kernel.compiled.*.o"))) == 1


def test_a_function_that_needs_memory_of_its_own_stays_with_numba(place: Path):
    def allocates(n):
        return np.zeros(n).sum() + n

    native = Native("double", ("int",), allocates)
    assert native.address
    assert not list(place.glob("*.o"))
    entered = Entry("double", ("int",), native.function)
    with pytest.raises(RuntimeError, match="needs more than mathematics"):
        entered(3)


def test_each_form_of_the_processor_is_another_code_that_numba_compiles_once(place: Path, monkeypatch):
    native = Native("double", ("double", "double"), ours(lambda a, b: math.sqrt(a) / b + a * b))
    plain, avx, _ = machine.X86_64
    code = native.emit_object(plain)
    monkeypatch.setattr("twin.kernel.compiled.native.inner_module", lambda *asked: pytest.fail("compiled again"))
    assert native.emit_object(avx) != code
    assert len({machine.object_name(native.name, form) for form in machine.X86_64}) == 3


@pytest.fixture
def chosen(monkeypatch: pytest.MonkeyPatch) -> Iterator[Callable[[str], str]]:
    """The name of the form that a process with that TWIN_PROCESSOR chooses."""

    def choose(given: str) -> str:
        monkeypatch.setenv(machine.PROCESSOR_VARIABLE, given)
        machine.chosen_form.cache_clear()
        return machine.chosen_form().name

    yield choose
    machine.chosen_form.cache_clear()


@pytest.mark.skipif(platform.machine() not in ("x86_64", "AMD64"), reason="others have one form")
def test_a_process_has_the_richest_form_that_its_processor_can_run_or_the_one_that_is_asked_for(chosen, monkeypatch):
    here = {"avx": True, "avx512f": True, "avx512vl": True}
    monkeypatch.setattr(llvm, "get_host_cpu_features", lambda: here)
    assert [chosen(given) for given in ("", "any", "avx", "avx512")] == ["avx512", "any", "avx", "avx512"]
    here["avx512vl"] = False
    assert chosen("") == "avx"
    refusal = r"^TWIN_PROCESSOR=avx512: expected one of what this processor can run: any, avx$"
    with pytest.raises(InputRefused, match=refusal):
        chosen("avx512")


def test_where_nothing_can_be_kept_the_code_runs_all_the_same(monkeypatch: pytest.MonkeyPatch, tmp_path: Path):
    monkeypatch.setattr(store, "object_folder", lambda: tmp_path / "gone")
    assert Entry("double", ("double",), ours(lambda x: x + 0.25))(1.0) == 1.25


def test_the_interpreters_lock_is_free_while_it_runs(place: Path):
    def waits(address):
        while load(address) == 0:
            pass
        return 1

    waiting, flag, seen = Entry("int", ("int",), ours(waits)), np.zeros(1, dtype=np.int32), []
    assert waiting.native.address
    thread = threading.Thread(target=lambda: seen.append(waiting(flag.ctypes.data)))
    thread.start()
    flag[0] = 1
    thread.join(60.0)
    assert seen == [1]


USES = """
import sys, tempfile
from twin.kernel.compiled.machine import _loaded
from twin.robot.assembly.load import load_experiment
from twin.robot.assembly.precompile import common_functions
from twin.robot.run.run import execute
with tempfile.TemporaryDirectory() as folder:
    execute(load_experiment("fig4_force_position"), folder)
print("numba" in sys.modules, sorted({n.name for n in common_functions()} ^ _loaded))
"""


@pytest.mark.slow
def test_a_run_of_fig_4_needs_what_is_usual_and_no_numba():
    ran = [subprocess.run([sys.executable, "-c", USES], capture_output=True, text=True, check=True) for _ in range(2)]
    assert ran[1].stdout.split() == ["False", "[]"], ran[1].stdout


def test_a_function_keeps_its_name_and_its_words():
    def told(x):
        """Says so."""
        return x

    function = Function(told)
    assert (function.__name__, function.__doc__, function.__wrapped__) == ("told", "Says so.", told)
    with pytest.raises(AttributeError):
        _ = function.__array_interface__


ARRAYS = [
    np.empty(5),
    np.empty((4, 6))[1::2, 3:],
    np.frombuffer(b"read only", dtype=np.uint8),
    np.empty(3, dtype=[("a", "i8"), ("b", "f4")])["b"],
    np.empty(4).view(np.recarray),
]


@pytest.mark.parametrize("array", ARRAYS)
def test_the_address_of_an_array_is_the_one_that_numpy_tells(array: np.ndarray):
    assert address_of(array) == array.ctypes.data
