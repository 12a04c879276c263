"""An SSP archive: its structure, and the files that belong to it."""

import os
from dataclasses import dataclass
from pathlib import Path

from twin.kernel.archive import content_of, entries, entry_of, sha256
from twin.kernel.errors import InputRefused
from twin.kernel.files import LIMIT
from twin.kernel.ssp.ssd import Resource, structure_of
from twin.kernel.ssp.structure import STRUCTURE, Structure

MOST_STRUCTURE = 16 << 20
MOST_FMU = 512 << 20
"""Bytes, unpacked of the structure, packed of an FMU."""


@dataclass(frozen=True)
class Package:
    """An SSP archive that has been read.

    Attributes:
        file: of the archive.
        sha256: of its bytes.
        entries: sizes (bytes) of what is in it, by name.
        structure: of the system.
    """

    file: Path
    sha256: str
    entries: dict[str, int]
    structure: Structure

    def entry(self, source: str) -> str:
        """The entry that a URI in the structure means; "": it is no file of this archive."""
        return entry_of(source, self.entries, STRUCTURE)

    def content(self, entry: str) -> bytes:
        """Of an FMU.

        Raises:
            InputRefused: it is too large.
        """
        return content_of(self.file, entry, MOST_FMU)


def read_package(file: Path) -> Package:
    """The SSP archive `file`.

    Raises:
        InputRefused: no whole SSP, or as `structure_of`; a parameter set is missing or lies outside.
    """
    # not Path.is_file, which raises for a name that is too long
    if not os.path.isfile(file):
        raise InputRefused(f"{file}: no such SSP")
    sizes = entries(file, "SSP")
    if STRUCTURE not in sizes:
        raise InputRefused(f"{file}: no {STRUCTURE} inside; this is not an SSP")

    def brought(source: str, what: str) -> Resource:
        entry = entry_of(source, sizes, STRUCTURE)
        if not entry:
            raise InputRefused(f"{file}: {what}: '{source}' is no file of this archive")
        return Resource(content_of(file, entry, LIMIT), entry, f"{file}: {entry}")

    where = f"{file}: {STRUCTURE}"
    return Package(file, sha256(file), sizes, structure_of(content_of(file, STRUCTURE, MOST_STRUCTURE), where, brought))
