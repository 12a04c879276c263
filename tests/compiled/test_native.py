"""Machine code that is kept, found again and entered from Python; what numba sees of the names it is written with."""

import itertools
import math
import random
import subprocess
import sys
import threading
import time
from collections.abc import Callable
from pathlib import Path

import numpy as np
import pytest

from tests.damage import KINDS, damage
from twin.compiled import emission, seal, store
from twin.compiled.function import Function, carray, njit
from twin.compiled.native import Entry, Native
from twin.cosim.native import doubles_at
from twin.runs.guard.futex import load

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
    monkeypatch.setattr(store, "_folder", lambda: folder)
    monkeypatch.setattr(seal, "_told", set())
    return folder


def ours(function: Callable) -> Callable:
    """`function` as if it were of a module of this package that no other test has."""
    function.__module__, function.__name__ = f"twin.of_test_{next(_numbers)}", "it"
    return function


def test_what_stands_for_numbas_names_is_compiled_as_those_are():
    values = np.array([1.0, 2.5, -4.0])
    assert summed(values.ctypes.data, 3) == 2.0 * values.sum() == summed.py_func.__globals__["doubled"](values.sum())


def test_a_function_that_only_compiled_code_calls_is_never_compiled_for_python():
    @njit(cache=False)
    def inner(x):
        return x + 1.0

    @njit(cache=False)
    def outer(x):
        return inner(x) + 1.0

    assert outer(1.0) == 3.0
    assert "called" not in vars(inner) and "called" in vars(outer)


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
    monkeypatch.setattr(store, "_loaded", set())
    monkeypatch.setattr(Native, "_emitted", lambda self, name: pytest.fail("compiled again"))
    assert Native("double", ("double",), first.function).is_there
    assert not Native("double", ("double", "double"), first.function).is_there


def test_what_is_built_into_something_else_is_not_compiled_once_more(place: Path, monkeypatch: pytest.MonkeyPatch):
    function = ours(lambda x: math.sin(x) + 2.0 * x)
    native = Native("double", ("double",), function)
    assert native.address
    monkeypatch.setattr(emission, "module_of", lambda *asked: pytest.fail("compiled again"))
    kept = Native("double", ("double",), function).module("another_name")
    assert kept.symbol == "another_name" and kept.inner in kept.text
    # what was damaged is compiled anew
    (file,) = place.glob("*.ll")
    file.write_bytes(file.read_bytes()[:-1])
    with pytest.raises(pytest.fail.Exception, match="compiled again"):
        Native("double", ("double",), function).module("another_name")


@pytest.mark.parametrize("kind", KINDS)
def test_a_damaged_object_file_is_thrown_away_made_again_and_told_once(
    place: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str], kind: str
):
    function = ours(lambda x: 3.0 * x)
    native = Native("double", ("double",), function)
    assert native.address
    (file,) = place.glob("*.o")
    sound = file.read_bytes()
    damage(file, kind, random.Random(1))
    monkeypatch.setattr(store, "_loaded", set())
    assert not Native("double", ("double",), function).is_there
    # a link to nowhere is a file that is not there
    assert ("was damaged: compiled again" in capsys.readouterr().err) == (kind != "link")
    store.take(file.stem, sound[: -seal.SIZE])
    assert file.read_bytes() == sound


def test_what_it_is_closed_over_tells_it_from_others(place: Path):
    def made(factor, table=None):
        def times(x):
            return factor * x if table is None else x

        times.__module__ = "twin.of_test"
        return Native("double", ("double",), times)

    names = {made(factor)._name for factor in (1, 1.0, True, (1, 2), "1", None, PAIR, doubled)}
    assert len(names) == 8
    assert made(2.0)._name == made(2.0)._name
    with pytest.raises(store.Unnamed):
        _ = made(1.0, object())._name


def test_a_function_of_somebody_else_stays_with_numba(place: Path):
    native = Native("double", ("double",), lambda x: x + 1.0)
    with pytest.raises(store.Unnamed):
        _ = native._name
    assert native.address
    assert not place.exists()


def test_a_function_that_needs_memory_of_its_own_stays_with_numba(place: Path):
    def allocates(n):
        return np.zeros(n).sum() + n

    # numba imports the module of what it loads
    allocates.__module__ = "twin.errors"
    native = Native("double", ("int",), allocates)
    assert native.address
    assert not list(place.glob("*.o"))
    entered = Entry("double", ("int",), native.function)
    with pytest.raises(RuntimeError, match="needs more than mathematics"):
        entered(3)


def test_another_processor_or_compiler_is_another_file(place: Path, monkeypatch: pytest.MonkeyPatch):
    function = ours(lambda x: x)
    names = []
    for cpu in ("", "x86-64"):
        monkeypatch.setenv("NUMBA_CPU_NAME", cpu)
        store._target.cache_clear()
        names.append(store.name_of(function, "()"))
    store._target.cache_clear()
    assert names[0] != names[1]


def test_whoever_needs_what_another_makes_waits_for_it(place: Path):
    order = []

    def make(number: int) -> None:
        with store.alone("it"):
            order.append(number)
            time.sleep(0.05)
            order.append(number)

    threads = [threading.Thread(target=make, args=(n,)) for n in range(4)]
    for thread in threads:
        thread.start()
    for thread in threads:
        thread.join()
    assert order[::2] == order[1::2]


def test_where_nothing_can_be_kept_the_code_runs_all_the_same(monkeypatch: pytest.MonkeyPatch, tmp_path: Path):
    (tmp_path / "file").write_text("")
    monkeypatch.setattr(store, "_folder", lambda: tmp_path / "file" / "objects")
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
from twin.compiled import store
from twin.runs.assembly.load import load_experiment
from twin.runs.assembly.usual import usual
from twin.runs.run import execute
with tempfile.TemporaryDirectory() as folder:
    execute(load_experiment("fig4_force_position"), folder)
print("numba" in sys.modules, sorted({n._name for n in usual()} ^ store._loaded))
"""


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
