"""Damaged files of compiled code are thrown away: no traceback, and no other code than was written."""

import random
from collections.abc import Callable
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import pytest
from numba.core import caching

from tests.damage import KINDS, damage
from twin.compiled import seal
from twin.compiled.seal import damaged_files

# whatever this process itself keeps its compiled code with
PLAIN = next(kind for kind in caching.IndexDataCacheFile.__mro__ if kind.__module__ == caching.__name__)
CODE = {("float64", "x86_64"): b"machine code" * 50, ("int64", "x86_64"): b"other code" * 50}


@pytest.fixture
def opened(tmp_path: Path) -> Callable[[], Any]:
    """What a new process would read the files of one function with."""

    def opened() -> Any:
        seal._told.clear()
        numbas = SimpleNamespace(IndexDataCacheFile=PLAIN)
        seal._change(numbas, tmp_path)
        (tmp_path / "plant").mkdir(exist_ok=True)
        return numbas.IndexDataCacheFile(str(tmp_path / "plant"), "dynamics-1.py311", (1.0, 100))

    return opened


def compiled(file: Any) -> None:
    """Look each function up, and save what is not there, as numba does."""
    for key, code in CODE.items():
        there = file.load(key)
        assert there in (None, code)
        if there is None:
            file.save(key, code)


def test_what_was_saved_is_loaded_and_nothing_is_said(
    opened: Callable[[], Any], tmp_path: Path, capsys: pytest.CaptureFixture[str]
):
    compiled(opened())
    assert [opened().load(key) for key in CODE] == list(CODE.values())
    assert damaged_files(tmp_path) == []
    assert capsys.readouterr().err == ""


@pytest.mark.parametrize("kind", KINDS)
@pytest.mark.parametrize("suffix", ["nbi", "nbc"])
def test_a_damaged_file_is_thrown_away_written_again_and_told_once(
    opened: Callable[[], Any], tmp_path: Path, capsys: pytest.CaptureFixture[str], kind: str, suffix: str
):
    compiled(opened())
    for file in sorted(tmp_path.rglob(f"*.{suffix}")):
        damage(file, kind, random.Random(1))
    assert damaged_files(tmp_path) == [] if kind == "link" else damaged_files(tmp_path)
    file = opened()
    compiled(file)
    compiled(file)
    said = capsys.readouterr().err
    assert said == f"twin: compiled code in {tmp_path}/ was damaged: compiled again\n" or (kind == "link" and not said)
    assert damaged_files(tmp_path) == []
    assert [opened().load(key) for key in CODE] == list(CODE.values())
    assert capsys.readouterr().err == ""


@pytest.mark.parametrize("rounds", [100, pytest.param(5000, marks=pytest.mark.endurance)])
def test_whatever_is_damaged_nothing_else_is_ever_loaded(
    opened: Callable[[], Any], tmp_path: Path, capsys: pytest.CaptureFixture[str], rounds: int
):
    for seed in range(rounds):
        draw = random.Random(seed)
        compiled(opened())
        files = sorted(tmp_path.rglob("*.nb?"))
        for file in draw.sample(files, draw.randrange(1, len(files) + 1)):
            damage(file, draw.choice(KINDS), draw)
        compiled(opened())
        assert [opened().load(key) for key in CODE] == list(CODE.values())
        assert capsys.readouterr().err.count("\n") <= 1


def test_two_processes_that_took_the_same_number_do_not_get_each_others_code(opened: Callable[[], Any]):
    (first, code), (second, other) = CODE.items()
    one, two = opened(), opened()
    one.save(first, code)
    # the other had looked before, when there was nothing
    two._load_index = lambda: {}
    two.save(second, other)
    one._save_index({first: "dynamics-1.py311.1.nbc"})
    assert opened().load(first) is None


def test_a_disk_that_is_full_costs_only_that_nothing_is_kept(
    opened: Callable[[], Any], monkeypatch: pytest.MonkeyPatch
):
    def full(name: str, data: Any) -> None:
        raise OSError(28, "No space left on device")

    file = opened()
    monkeypatch.setattr(file, "_save_data", full)
    file.save(*next(iter(CODE.items())))
    assert opened().load(next(iter(CODE))) is None


def test_files_elsewhere_are_numbas_own(opened: Callable[[], Any], tmp_path: Path):
    elsewhere = tmp_path.parent / f"{tmp_path.name}-elsewhere"
    elsewhere.mkdir()
    sealed, plain = (kind(str(elsewhere), "f", 1.0) for kind in (type(opened()), PLAIN))
    sealed.save("key", "data")
    assert plain.load("key") == "data"
    plain.save("other", "more")
    assert sealed.load("other") == "more"
