"""Machine code of another source is never used, nor what was damaged or belongs to somebody else."""

import os
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
from twin.kernel.compiled import store
from twin.kernel.compiled.function import njit
from twin.kernel.compiled.store import damaged_files, name_of, object_files, seal, store_file, stored_code

POSIX = pytest.mark.skipif(os.name != "posix", reason="owners and modes of POSIX")
WHERE = "import twin.kernel.compiled.store as s; print(s.object_folder()); print(s.refusal())"
CODE = {"twin.a.o": b"machine code" * 50, "twin.b.o": b"other code" * 50}


@pytest.fixture
def place(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    """An empty store."""
    folder = tmp_path / "objects"
    folder.mkdir(0o700)
    monkeypatch.setattr(store, "object_folder", lambda: folder)
    monkeypatch.setattr(store, "_reported", set())
    return folder


@njit(cache=True)
def doubled(x):
    return 2.0 * x


def test_what_it_is_closed_over_tells_it_from_others():
    def made(factor, table=None):
        def times(x):
            return factor * x if table is None else x

        return name_of(times, "kinds")

    pair = np.dtype([("a", "f8"), ("b", "f8")])
    assert len({made(factor) for factor in (1, 1.0, True, (1, 2), "1", None, pair, doubled)}) == 8
    assert made(2.0) == made(2.0)
    with pytest.raises(store.UnnamedFunction):
        made(1.0, object())
    assert name_of(doubled, "kinds") != name_of(doubled, "others")


def test_source_that_is_in_no_file_has_no_name():
    scope: dict[str, Callable] = {}
    exec("def f(x): return x", {"__name__": "nowhere"}, scope)
    with pytest.raises(store.UnnamedFunction):
        name_of(scope["f"], "")


def test_what_was_put_there_is_found_and_nothing_is_said(place: Path, capsys: pytest.CaptureFixture[str]):
    assert stored_code("twin.a.o") == b""
    for name, code in CODE.items():
        store_file(name, code)
    assert {name: stored_code(name) for name in CODE} == CODE
    assert (damaged_files(object_files()), [file.name for file in object_files()]) == ([], list(CODE))
    assert capsys.readouterr().err == ""


@pytest.mark.parametrize("kind", KINDS)
def test_a_damaged_file_is_thrown_away_and_told_once(place: Path, capsys: pytest.CaptureFixture[str], kind: str):
    for name, code in CODE.items():
        store_file(name, code)
        damage(place / name, kind, random.Random(1))
    # a link to nowhere is a file that is not there
    assert len(damaged_files(object_files())) == (0 if kind == "link" else 2)
    assert {stored_code(name) for name in CODE} == {b""}
    told = f"twin: compiled code in {place}/ was damaged: compiled again\n"
    assert capsys.readouterr().err == ("" if kind == "link" else told)
    for name, code in CODE.items():
        store_file(name, code)
        assert stored_code(name) == code
    assert damaged_files(object_files()) == []


@pytest.mark.parametrize("rounds", [100, pytest.param(5000, marks=pytest.mark.endurance)])
def test_whatever_is_damaged_nothing_else_is_ever_loaded(place: Path, rounds: int):
    for seed in range(rounds):
        draw = random.Random(seed)
        for name, code in CODE.items():
            store_file(name, code)
        for name in draw.sample(list(CODE), draw.randrange(1, 3)):
            damage(place / name, draw.choice(KINDS), draw)
        assert all(stored_code(name) in (b"", code) for name, code in CODE.items())


def test_what_came_with_the_package_is_looked_at_first_and_never_written(place: Path, monkeypatch, capsys):
    came = place.with_name("came")
    came.mkdir()
    monkeypatch.setattr(store, "PACKAGED_OBJECTS", came)
    store_file("twin.a.o", b"compiled here")
    (came / "twin.a.o").write_bytes(seal("twin.a.o", b"from the wheel"))
    assert stored_code("twin.a.o") == b"from the wheel"
    assert damaged_files(object_files(came)) == []
    # as it is not the user's to mend, nothing is said
    damage(came / "twin.a.o", "flipped", random.Random(1))
    changed = (came / "twin.a.o").read_bytes()
    assert stored_code("twin.a.o") == b"compiled here" and capsys.readouterr().err == ""
    assert damaged_files(object_files(came)) == [came / "twin.a.o"]
    store_file("twin.a.o", b"compiled again")
    assert (came / "twin.a.o").read_bytes() == changed


def test_a_file_that_took_the_name_of_another_one_is_not_loaded(place: Path):
    store_file("twin.a.o", CODE["twin.a.o"])
    (place / "twin.a.o").rename(place / "twin.b.o")
    assert stored_code("twin.b.o") == b""


@POSIX
def test_code_that_another_user_has_left_is_not_loaded(
    place: Path, give_away: Callable[[Path], None], capsys: pytest.CaptureFixture[str]
):
    store_file("twin.a.o", b"no good")
    give_away(place / "twin.a.o")
    assert stored_code("twin.a.o") == b"" and not object_files()
    assert capsys.readouterr().err.startswith(f"twin: {place}/twin.a.o: belongs to user 1234, not to you")


@POSIX
def test_code_that_others_can_write_to_is_not_loaded_and_ours_is_closed_to_them(place: Path):
    before = os.umask(0)
    try:
        store_file("twin.a.o", b"code")
    finally:
        os.umask(before)
    assert (place / "twin.a.o").stat().st_mode & 0o777 == 0o600
    (place / "twin.a.o").chmod(0o622)
    assert stored_code("twin.a.o") == b""


def test_what_was_used_last_stays(place: Path, monkeypatch: pytest.MonkeyPatch):
    monkeypatch.setattr(store, "MAX_FILES", 3)
    for k in range(3):
        store_file(f"twin.{k}.o", b"code")
        os.utime(place / f"twin.{k}.o", (k, k))
    assert stored_code("twin.0.o")
    store_file("twin.3.o", b"code")
    assert [file.name for file in object_files()] == ["twin.0.o", "twin.2.o", "twin.3.o"]


def test_a_disk_that_is_full_costs_only_that_nothing_is_kept(place: Path, monkeypatch: pytest.MonkeyPatch):
    def full(*asked: object) -> None:
        raise OSError(28, "No space left on device")

    monkeypatch.setattr(Path, "replace", full)
    store_file("twin.a.o", b"code")
    assert stored_code("twin.a.o") == b""


def test_whoever_needs_what_another_makes_waits_for_it(place: Path):
    order = []

    def make(number: int) -> None:
        with store.object_lock("it"):
            order.append(number)
            time.sleep(0.05)
            order.append(number)

    threads = [threading.Thread(target=make, args=(n,)) for n in range(4)]
    for thread in threads:
        thread.start()
    for thread in threads:
        thread.join()
    assert order[::2] == order[1::2]


def where(package: Path, **environment: str) -> tuple[Path, str]:
    """Folder and refusal of a new process that imports `package`."""
    clean = {name: value for name, value in os.environ.items() if name != store.FOLDER_VARIABLE}
    # -S: without site-packages it starts faster, and finds no other package of that name
    done = subprocess.run(
        [sys.executable, "-S", "-c", WHERE], cwd=package.parent, env={**clean, **environment}, capture_output=True,
        text=True, check=True,
    )  # fmt: skip
    folder, refusal = done.stdout.splitlines()
    return Path(folder), refusal


def test_it_is_beside_the_package_or_where_the_user_says(package: Path, tmp_path: Path):
    assert where(package) == (package / "__pycache__" / "native", "")
    assert where(package, NUMBA_CACHE_DIR=str(tmp_path / "mine")) == (tmp_path / "mine" / "objects", "")


@POSIX
def test_a_folder_that_others_can_write_to_is_left_for_the_users_own(package: Path, tmp_path: Path):
    where(package)[0].chmod(0o777)
    own = tmp_path / "own"
    assert where(package, TWIN_CACHE=str(own)) == (own / "native", "")
    assert {folder.stat().st_mode & 0o777 for folder in (own, own / "native")} == {0o700}


@POSIX
@pytest.mark.parametrize("wish", ["relative", "~nobody-here", "{open}", "numba"])
def test_without_a_folder_of_the_users_alone_nothing_is_kept(package: Path, tmp_path: Path, wish: str):
    for folder in (where(package)[0], tmp_path / "open", tmp_path / "open" / "objects"):
        folder.mkdir(exist_ok=True)
        folder.chmod(0o777)
    (tmp_path / "scratch").mkdir()
    before = {path for path in tmp_path.rglob("*") if "__pycache__" not in path.parts}
    wishes = {"TWIN_CACHE": wish.format(open=tmp_path / "open")}
    if wish == "numba":
        wishes = {store.FOLDER_VARIABLE: str(tmp_path / "open")}
    folder, why = where(package, TMPDIR=str(tmp_path / "scratch"), **wishes)
    assert folder.parents[1] == tmp_path / "scratch" and "TWIN_CACHE" in why
    assert {path for path in tmp_path.rglob("*") if "__pycache__" not in path.parts} == before
