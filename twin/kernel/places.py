"""Folders of the experiments, robots, bodies, drives and baselines of this package, and its source."""

import contextlib
import functools
import os
from collections.abc import Mapping
from pathlib import Path

PACKAGE = Path(__file__).parents[1]
CARRIED = PACKAGE / "carried"
"""Where a wheel puts them; a clone has no such folder."""

HOME = CARRIED if CARRIED.is_dir() else PACKAGE.parent
"""The folder with experiments/, fmus/ and tests/baselines/, found from anywhere: the repository of a clone, installed
as editable or not at all, else what the wheel carries inside the package."""

_MOST_SOURCES = 1 << 16
"""Bytes that are read at once, which is more than most sources have."""


def is_clone() -> bool:
    """Whether `HOME` is a repository, with pyproject.toml and tests, and may be written to."""
    return HOME != CARRIED


def located(name: str, start: Path) -> Path:
    """The file `name` as seen from folder `start`: absolute, in `start` or its parents, here, or in `HOME`.

    What is found nowhere is returned as a path in `start`, for the sentence that refuses it.
    """
    wanted = Path(name)
    # of an unknown user
    with contextlib.suppress(RuntimeError):
        wanted = wanted.expanduser()
    if wanted.is_absolute():
        return wanted
    for folder in (start, *start.parents, Path.cwd(), HOME, HOME / "experiments"):
        # not Path.exists, which raises for a name that is too long
        if os.path.exists(folder / wanted):
            return folder / wanted
    return start / wanted


@functools.cache
def sources(package: str, *rooms: str) -> Mapping[str, bytes]:
    """Content of the Python files of `package` by their names below it, sorted; as it is when first asked for.

    Most commands ask, so that every call counts here.

    Args:
        rooms: folders such as "robot/plant", of which the files are wanted besides those above them; none: all.
    """
    found = {}
    folders = [package]
    while folders:
        folder = folders.pop()
        place = folder[len(package) + 1 :].replace(os.sep, "/")
        all_wanted = not rooms or any(place == room or place.startswith(f"{room}/") for room in rooms)
        with os.scandir(folder) as entries:
            for entry in entries:
                if entry.name.endswith(".py"):
                    found[entry.path[len(package) + 1 :]] = _content(entry.path)
                elif not entry.is_dir(follow_symlinks=False) or entry.name == "__pycache__":
                    continue
                elif all_wanted or any(f"{room}/".startswith(f"{place}/{entry.name}/".lstrip("/")) for room in rooms):
                    folders.append(entry.path)
    return dict(sorted(found.items()))


def _content(path: str) -> bytes:
    handle = os.open(path, os.O_RDONLY | getattr(os, "O_BINARY", 0))
    try:
        content = part = os.read(handle, _MOST_SOURCES)
        while len(part) == _MOST_SOURCES:
            part = os.read(handle, _MOST_SOURCES)
            content += part
        return content
    finally:
        os.close(handle)
