"""Folders of the experiments, robots, bodies, drives and baselines of this package, and its source."""

import contextlib
import functools
import os
from collections.abc import Mapping
from pathlib import Path

PACKAGE_FOLDER = Path(__file__).parents[1]
WHEEL_FOLDER = PACKAGE_FOLDER / "carried"
"""Where a wheel puts them; a clone has no such folder."""

PROJECT_FOLDER = WHEEL_FOLDER if WHEEL_FOLDER.is_dir() else PACKAGE_FOLDER.parent
"""The folder with experiments/, fmus/ and tests/baselines/, found from anywhere: the repository of a clone, installed
as editable or not at all, else what the wheel carries inside the package."""


def is_clone() -> bool:
    """Whether `PROJECT_FOLDER` is a repository, with pyproject.toml and tests, and may be written to."""
    return PROJECT_FOLDER != WHEEL_FOLDER


def locate_file(name: str, start: Path) -> Path:
    """The file `name` as seen from folder `start`: absolute, in `start` or its parents, here, or in `PROJECT_FOLDER`.

    What is found nowhere is returned as a path in `start`, for the sentence that refuses it.
    """
    wanted = Path(name)
    # of an unknown user
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
    """Content of the Python files of `package` by their names below it, sorted; as it is when first asked for."""
    found = {str(path.relative_to(package)): path.read_bytes() for path in Path(package).rglob("*.py")}
    return dict(sorted(found.items()))
