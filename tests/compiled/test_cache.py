"""Compiled code of an older source is never used again."""

import os
import random
import re
import shutil
import subprocess
import sys
from collections.abc import Callable
from pathlib import Path

import pytest

from tests.damage import damage
from twin.compiled import cache
from twin.compiled.cache import COMPILES, KEPT, is_own, source_digest
from twin.compiled.seal import damaged_files, sealed
from twin.places import sources

POSIX = pytest.mark.skipif(os.name != "posix", reason="owners and modes of POSIX")
SOURCE = Path(__file__).parents[2] / "twin"
WHERE = "import os, twin.compiled.cache; twin.compiled.cache.use_cache(); print(os.environ['NUMBA_CACHE_DIR'])"
KERNEL = """from numba import njit

@njit(cache=True)
def twice(x):
    return 2 * x

@njit(cache=True)
def fourfold(x):
    return 2 * twice(x)
"""
USE = "import twin.deep.kernel as k; assert k.twice(2.0) == 4.0 and k.fourfold(2) == 8"


@pytest.fixture
def package(tmp_path: Path) -> Path:
    """A package of the same name with the one module that matters, and a module to edit."""
    folder = tmp_path / "twin"
    (folder / "deep").mkdir(parents=True)
    for file in SOURCE.glob("*.py"):
        shutil.copy(file, folder)
    shutil.copytree(SOURCE / "compiled", folder / "compiled", ignore=shutil.ignore_patterns("__pycache__"))
    (folder / "deep" / "kernel.py").write_text(KERNEL)
    (folder / "deep" / "part.py").write_text("x = 1\n")
    (folder / "picture").mkdir()
    return folder


def cache_folder(package: Path, **environment: str) -> Path:
    """Where a new process that imports `package` keeps compiled code."""
    # -S: without site-packages it starts faster, and finds no other package of that name
    return Path(ran(package, "-S", "-c", WHERE, **environment).stdout.strip())


def ran(package: Path, *arguments: str, **environment: str) -> subprocess.CompletedProcess[str]:
    """A new process of Python beside `package`, which has ended well."""
    clean = {name: value for name, value in os.environ.items() if name != "NUMBA_CACHE_DIR"}
    done = subprocess.run(
        [sys.executable, *arguments], cwd=package.parent, env={**clean, **environment}, capture_output=True, text=True
    )
    assert done.returncode == 0, done.stderr
    return done


def test_an_edit_beside_compiled_code_leads_to_another_folder_and_back(package):
    before = cache_folder(package)
    (package / "deep" / "part.py").write_text("x = 2\n")
    edited = cache_folder(package)
    (package / "deep" / "part.py").write_text("x = 1\n")
    assert edited != before == cache_folder(package)
    assert package in before.parents


def digest(package: Path) -> str:
    """As another process would find it."""
    sources.cache_clear()
    return source_digest(package)


def test_a_renamed_file_counts_as_an_edit(package):
    before = digest(package)
    # a name that sorts into the same place: the contents in order are the same
    (package / "deep" / "part.py").rename(package / "deep" / "piece.py")
    assert digest(package) != before


def test_what_no_compiled_code_is_made_of_does_not_count(package):
    before = digest(package)
    (package / "notes.txt").write_text("no source")
    (package / "picture" / "page.py").write_text("title = 'in a package without compiled code'\n")
    assert digest(package) == before
    (package / "picture" / "page.py").write_text("import numba\n")
    assert digest(package) != before


def test_compiled_packages_import_only_packages_that_count():
    # else a constant frozen into machine code could change without a new folder
    importing = {file for file in SOURCE.rglob("*.py") if COMPILES.search(file.read_bytes())}
    counted = {file.relative_to(SOURCE).parts[0] for file in importing}
    assert {"plant", "robot", "cosim"} <= counted
    for file in importing:
        imported = set(re.findall(r"^\s*(?:from|import) twin\.(\w+)", file.read_text(), re.MULTILINE))
        assert imported <= counted | {"errors", "cache_folder"}, file


def test_old_folders_are_dropped_and_the_present_one_never(package):
    for version in range(KEPT + 3):
        (package / "deep" / "part.py").write_text(f"x = {version}\n")
        present = cache_folder(package)
        assert present.is_dir()
    assert len(list(present.parent.iterdir())) == KEPT


def test_a_cache_folder_of_the_users_own_is_respected(package, tmp_path):
    assert cache_folder(package, NUMBA_CACHE_DIR=str(tmp_path / "mine")) == tmp_path / "mine"


def test_the_processes_that_one_starts_keep_their_code_where_it_does(package: Path):
    folder = cache_folder(package)
    assert cache_folder(package, NUMBA_CACHE_DIR=str(folder)) == folder
    assert is_own(cache.compiled_home(SOURCE) / "0123456789abcdef")


@POSIX
def test_a_folder_that_others_can_write_to_is_left_for_the_users_own(package: Path, tmp_path: Path):
    beside = cache_folder(package).parent
    beside.chmod(0o777)
    own = tmp_path / "own"
    assert cache_folder(package, TWIN_CACHE=str(own)).parent == own / "native"
    assert {folder.stat().st_mode & 0o777 for folder in (own, own / "native")} == {0o700}


@POSIX
@pytest.mark.parametrize("wish", ["relative", "~nobody-here", "{open}"])
def test_without_a_folder_of_the_users_alone_nothing_is_kept(package: Path, tmp_path: Path, wish: str):
    cache_folder(package).parent.chmod(0o777)
    (tmp_path / "open").mkdir()
    (tmp_path / "open").chmod(0o777)
    (tmp_path / "scratch").mkdir()
    before = {path for path in tmp_path.rglob("*") if "__pycache__" not in path.parts}
    place = ran(
        package, "-S", "-c", f"{WHERE}; import twin.compiled.cache as n; print(n.refusal())",
        TWIN_CACHE=wish.format(open=tmp_path / "open"), TMPDIR=str(tmp_path / "scratch"),
    ).stdout  # fmt: skip
    folder, why = place.splitlines()
    assert Path(folder).parent == tmp_path / "scratch" and ("TWIN_CACHE" in why)
    assert {path for path in tmp_path.rglob("*") if "__pycache__" not in path.parts} == before


@POSIX
@pytest.mark.parametrize("inner", [".", "objects", "deep_0123/kernel-1.py311.1.nbc"])
def test_code_that_another_user_has_left_is_not_loaded(
    tmp_path: Path, give_away: Callable[[Path], None], capsys: pytest.CaptureFixture[str], inner: str
):
    folder = cache._made(tmp_path, "0123456789abcdef")
    assert cache._made(tmp_path, folder.name) == folder and capsys.readouterr().err == ""
    (folder / "objects").mkdir()
    (folder / "deep_0123").mkdir()
    (folder / "deep_0123" / "kernel-1.py311.1.nbc").write_bytes(sealed(b"no good"))
    give_away(folder / inner)
    assert cache._made(tmp_path, folder.name) == folder
    assert list(folder.iterdir()) == [] and folder.stat().st_uid == os.geteuid()
    assert capsys.readouterr().err.startswith(f"twin: {folder / inner}: belongs to user 1234, not to you")


def test_damaged_code_is_compiled_again_in_processes_and_in_those_they_start(package: Path):
    folder = cache_folder(package)
    assert ran(package, "-c", USE).stderr == ""
    draw = random.Random(1)
    for started_by in ({}, {"NUMBA_CACHE_DIR": str(folder)}):
        files = sorted(folder.rglob("*.nb?"))
        # an index for each of two functions, and three pieces of code
        for file, kind in zip(files, ("truncated", "emptied", "garbage", "folder", "pickle"), strict=True):
            damage(file, kind, draw)
        assert ran(package, "-c", USE, **started_by).stderr == (
            f"twin: compiled code in {folder}/ was damaged: compiled again\n"
        )
    assert damaged_files(folder) == []


@pytest.mark.parametrize("depth", [0, 1])
def test_a_file_where_a_folder_should_be_is_replaced(package: Path, depth: int):
    folder = cache_folder(package)
    place = folder / "deep_0123" if depth else folder
    shutil.rmtree(place, ignore_errors=True)
    place.write_bytes(b"a file")
    place.chmod(0o700)
    assert cache_folder(package) == folder
    assert folder.is_dir() and not place.is_file()
