"""Compiled code of an older source is never used again."""

import os
import re
import shutil
import subprocess
import sys
from pathlib import Path

import pytest

from twin.native_cache import COMPILES, KEPT, source_digest

SOURCE = Path(__file__).parents[1] / "twin"
WHERE = "import os, twin; print(os.environ['NUMBA_CACHE_DIR'])"


@pytest.fixture
def package(tmp_path: Path) -> Path:
    """A package of the same name with the one module that matters, and a module to edit."""
    folder = tmp_path / "twin"
    (folder / "deep").mkdir(parents=True)
    shutil.copy(SOURCE / "native_cache.py", folder)
    shutil.copy(SOURCE / "__init__.py", folder)
    (folder / "deep" / "kernel.py").write_text("from numba import njit\n")
    (folder / "deep" / "part.py").write_text("x = 1\n")
    (folder / "picture").mkdir()
    return folder


def cache_folder(package: Path, **environment: str) -> Path:
    """Where a new process that imports `package` keeps compiled code."""
    clean = {name: value for name, value in os.environ.items() if name != "NUMBA_CACHE_DIR"}
    # -S: without site-packages it starts faster, and finds no other package of that name
    command = [sys.executable, "-S", "-c", WHERE]
    done = subprocess.run(
        command, cwd=package.parent, env={**clean, **environment}, capture_output=True, text=True, check=True
    )
    return Path(done.stdout.strip())


def test_an_edit_beside_compiled_code_leads_to_another_folder_and_back(package):
    before = cache_folder(package)
    (package / "deep" / "part.py").write_text("x = 2\n")
    edited = cache_folder(package)
    (package / "deep" / "part.py").write_text("x = 1\n")
    assert edited != before == cache_folder(package)
    assert package in before.parents


def test_a_renamed_file_counts_as_an_edit(package):
    before = source_digest(package)
    # a name that sorts into the same place: the contents in order are the same
    (package / "deep" / "part.py").rename(package / "deep" / "piece.py")
    assert source_digest(package) != before


def test_what_no_compiled_code_is_made_of_does_not_count(package):
    before = source_digest(package)
    (package / "notes.txt").write_text("no source")
    (package / "picture" / "page.py").write_text("title = 'in a package without compiled code'\n")
    assert source_digest(package) == before
    (package / "picture" / "page.py").write_text("import numba\n")
    assert source_digest(package) != before


def test_compiled_packages_import_only_packages_that_count():
    # else a constant frozen into machine code could change without a new folder
    importing = {file for file in SOURCE.rglob("*.py") if COMPILES.search(file.read_bytes())}
    counted = {file.relative_to(SOURCE).parts[0] for file in importing}
    assert {"plant", "robot", "cosim"} <= counted
    for file in importing:
        imported = set(re.findall(r"^\s*(?:from|import) twin\.(\w+)", file.read_text(), re.MULTILINE))
        assert imported <= counted | {"errors", "native_cache"}, file


def test_old_folders_are_dropped_and_the_present_one_never(package):
    for version in range(KEPT + 3):
        (package / "deep" / "part.py").write_text(f"x = {version}\n")
        present = cache_folder(package)
        assert present.is_dir()
    assert len(list(present.parent.iterdir())) == KEPT


def test_a_cache_folder_of_the_users_own_is_respected(package, tmp_path):
    assert cache_folder(package, NUMBA_CACHE_DIR=str(tmp_path / "mine")) == tmp_path / "mine"
