"""Drive FMUs made unfit on purpose, from a good one."""

import zipfile
from collections.abc import Callable
from pathlib import Path

from twin.studies.reference.outcome import MANIFEST_FOLDER

DESCRIPTION = "modelDescription.xml"


def altered(good: Path, bad: Path, change: Callable[[str, bytes], tuple[str, bytes] | None]) -> Path:
    """A copy of `good` in which `change` renames, rewrites or (None) drops each entry."""
    with zipfile.ZipFile(good) as source, zipfile.ZipFile(bad, "w") as target:
        for name in source.namelist():
            changed = change(name, source.read(name))
            if changed is not None:
                target.writestr(*changed)
    return bad


def redescribed(good: Path, bad: Path, old: str, new: str) -> Path:
    """A copy of `good` with `old` replaced by `new` in its model description."""

    def change(name: str, content: bytes) -> tuple[str, bytes]:
        if name != DESCRIPTION:
            return name, content
        assert old in content.decode(), f"{old!r} does not stand in the description"
        return name, content.decode().replace(old, new).encode()

    return altered(good, bad, change)


def carrying(good: Path, file: Path, entries: dict[str, str | bytes]) -> Path:
    """A copy of `good` with these `entries` in place of its reference files."""
    altered(good, file, lambda name, content: None if name.startswith(MANIFEST_FOLDER) else (name, content))
    with zipfile.ZipFile(file, "a") as target:
        for name, content in entries.items():
            target.writestr(name, content)
    return file
