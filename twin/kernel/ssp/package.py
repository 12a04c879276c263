"""A system as its files have it: an SSP archive, or files beside each other that say the same.

What runs a system asks for the structure, and for the content of what that names; where both are from is known here
alone.
"""

import os
from collections.abc import Mapping
from dataclasses import dataclass, field
from pathlib import Path
from typing import cast, get_args

from twin.kernel.archive import entries, entry_of, read_entry, sha256
from twin.kernel.cosim.interpolation import Scheme
from twin.kernel.errors import InputRefused
from twin.kernel.files import MAX_TEXT_BYTES, parse_xml, read_bytes
from twin.kernel.ssp.ssd import Resource, structure_of
from twin.kernel.ssp.structure import STRUCTURE_FILE, Structure

SCHEME_ANNOTATION = "twin.scheme"
"""Type of the annotation of a system that says by which scheme it is coupled."""
MAX_STRUCTURE_SIZE = 16 << 20
MAX_FMU_SIZE = 512 << 20
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
    omissions: tuple[str, ...] = ()

    def entry(self, source: str) -> str:
        """The entry that a URI in the structure means; "": it is no file of this archive."""
        if self.loose:
            return source if source in self.entries else ""
        return entry_of(source, self.entries, STRUCTURE_FILE)

    def content(self, entry: str) -> bytes:
        """Of an FMU, or of a table.

        Raises:
            InputRefused: it is too large.
        """
        if self.loose:
            return read_bytes(self.loose[entry], MAX_FMU_SIZE)
        return read_entry(self.file, entry, MAX_FMU_SIZE)


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
    if STRUCTURE_FILE not in sizes:
        raise InputRefused(f"{file}: no {STRUCTURE_FILE} inside; this is not an SSP")

    def brought(source: str, what: str) -> Resource:
        entry = entry_of(source, sizes, STRUCTURE_FILE)
        if not entry:
            raise InputRefused(f"{file}: {what}: '{source}' is no file of this archive")
        return Resource(read_entry(file, entry, MAX_TEXT_BYTES), entry, f"{file}: {entry}")

    where = f"{file}: {STRUCTURE_FILE}"
    structure = structure_of(read_entry(file, STRUCTURE_FILE, MAX_STRUCTURE_SIZE), where, brought)
    return Package(file, sha256(file), sizes, structure, scheme=_scheme(structure, where))


def _scheme(structure: Structure, where: str) -> Scheme:
    """Of the coupling, where an annotation says it."""
    for note in structure.system.annotations:
        if note.type == SCHEME_ANNOTATION and note.content:
            name = parse_xml(note.content.encode(), f"{where}: annotation {SCHEME_ANNOTATION}").get("name", "")
            if name not in get_args(Scheme):
                known = " or ".join(get_args(Scheme))
                raise InputRefused(f"{where}: annotation {SCHEME_ANNOTATION}: '{name}'; expected {known}")
            return cast(Scheme, name)
    return "gauss_seidel"
