"""Folders of the experiments, robots, bodies, drives and baselines of this package, and its source."""

import contextlib
import functools
import os
from collections.abc import Mapping
from pathlib import Path

PACKAGE_FOLDER = Path(__file__).parents[1]
WHEEL_FOLDER = PACKAGE_FOLDER / "carried"
"""Data folder within an installed wheel; missing in a clone."""

PROJECT_FOLDER = WHEEL_FOLDER if WHEEL_FOLDER.is_dir() else PACKAGE_FOLDER.parent
"""Folder with experiments/, fmus/ and tests/baselines/: the repository if run from a clone, otherwise the data folder
inside the installed package."""


def is_clone() -> bool:
    """Whether twin runs from a clone of its repository, with pyproject.toml and tests, that may be written to."""
    return PROJECT_FOLDER != WHEEL_FOLDER


def locate_file(name: str, start: Path) -> Path:
    """Find a file by name, searching from a folder upwards, and return its path.

    Absolute paths are returned as they are; others are searched in `start` and its parents, the current folder and
    `PROJECT_FOLDER`. A missing file is returned as a path in `start`, for the error message.
    """
    wanted = Path(name)
    # expanduser raises for an unknown user
    with contextlib.suppress(RuntimeError):
        wanted = wanted.expanduser()
    if wanted.is_absolute():
        return wanted
    for folder in (start, *start.parents, Path.cwd(), PROJECT_FOLDER, PROJECT_FOLDER / "experiments"):
        # not Path.exists, which raises for a name that is too long
        if os.path.exists(folder / wanted):
            return folder / wanted
    return start / wanted


@functools.cache
def package_sources(package: str) -> Mapping[str, bytes]:
    """Read the Python files of a package: content by relative path, sorted, cached at the first call."""
    found = {str(path.relative_to(package)): path.read_bytes() for path in Path(package).rglob("*.py")}
    return dict(sorted(found.items()))
