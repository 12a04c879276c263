"""A system as its files have it: an SSP archive, or files beside each other that say the same.

What runs a system asks for the structure, and for the content of what that names; where both are from is known here
alone.
"""

import os
from collections.abc import Mapping
from dataclasses import dataclass, field
from pathlib import Path
from typing import cast, get_args

from twin.kernel.archive import content_of, entries, entry_of, sha256
from twin.kernel.cosim.interpolation import Scheme
from twin.kernel.errors import InputRefused
from twin.kernel.files import LIMIT, read_bytes, xml_of
from twin.kernel.ssp.ssd import Resource, structure_of
from twin.kernel.ssp.structure import STRUCTURE, Structure

SCHEME = "twin.scheme"
"""Type of the annotation of a system that says by which scheme it is coupled."""
MOST_STRUCTURE = 16 << 20
MOST_FMU = 512 << 20
"""Bytes, unpacked of the structure, packed of an FMU."""


@dataclass(frozen=True)
class Package:
    """A system that has been read.

    Attributes:
        file: of the archive, or of what says which files belong to it.
        sha256: of its bytes.
        entries: sizes (bytes) of what is in it, by name.
        structure: of the system.
        form: what kind of file it is, for people.
        scheme: of the coupling, by who has written such files.
        loose: files that stand for entries, where there is no archive.
        unsaid: what the file says and is passed over, a sentence each.
    """

    file: Path
    sha256: str
    entries: dict[str, int]
    structure: Structure
    form: str = "SSP"
    scheme: Scheme = "gauss_seidel"
    loose: Mapping[str, Path] = field(default_factory=dict)
    unsaid: tuple[str, ...] = ()

    def entry(self, source: str) -> str:
        """The entry that a URI in the structure means; "": it is no file of this archive."""
        if self.loose:
            return source if source in self.entries else ""
        return entry_of(source, self.entries, STRUCTURE)

    def content(self, entry: str) -> bytes:
        """Of an FMU, or of a table.

        Raises:
            InputRefused: it is too large.
        """
        if self.loose:
            return read_bytes(self.loose[entry], MOST_FMU)
        return content_of(self.file, entry, MOST_FMU)


def loose_package(
    file: Path,
    structure: Structure,
    files: Mapping[str, Path],
    form: str,
    scheme: Scheme = "gauss_seidel",
    unsaid: tuple[str, ...] = (),
) -> Package:
    """A system whose files are in no archive; `files` by what the structure calls them, the others as of `Package`."""
    return Package(
        file,
        sha256(file) if file.is_file() else "",
        {name: path.stat().st_size for name, path in files.items()},
        structure,
        form,
        scheme,
        files,
        unsaid,
    )


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
    structure = structure_of(content_of(file, STRUCTURE, MOST_STRUCTURE), where, brought)
    return Package(file, sha256(file), sizes, structure, scheme=_scheme(structure, where))


def _scheme(structure: Structure, where: str) -> Scheme:
    """Of the coupling, where an annotation says it."""
    for note in structure.system.annotations:
        if note.type == SCHEME and note.content:
            name = xml_of(note.content.encode(), f"{where}: annotation {SCHEME}").get("name", "")
            if name not in get_args(Scheme):
                known = " or ".join(get_args(Scheme))
                raise InputRefused(f"{where}: annotation {SCHEME}: '{name}'; expected {known}")
            return cast(Scheme, name)
    return "gauss_seidel"
