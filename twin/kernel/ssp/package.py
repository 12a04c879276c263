"""Packages: a system and its FMUs and tables, from an SSP archive or from loose files of another format.

Code that runs a system gets structure and entries from a `Package`; only this module knows where both are stored.
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
"""Type of the system annotation that names the coupling scheme."""
MAX_STRUCTURE_SIZE = 16 << 20
MAX_FMU_SIZE = 512 << 20
"""Maximum sizes (bytes): of the structure unpacked, of an FMU packed."""


@dataclass(frozen=True)
class Package:
    """A system read from an archive or files: its structure, and access to its FMUs and tables.

    `file` is the archive, or names the other files. `entries` has sizes (bytes) by entry name, `loose` files by entry
    name (empty for an archive). `form` names the format, for messages, `scheme` the coupling that its tools use.
    `omissions` are ignored statements, one sentence each.
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
        """Return the package's entry that a URI of the structure refers to; "" if it is not a file of this package."""
        if self.loose:
            return source if source in self.entries else ""
        return entry_of(source, self.entries, STRUCTURE_FILE)

    def content(self, entry: str) -> bytes:
        """Read the content of a package's entry, an FMU or a table of at most `MAX_FMU_SIZE`."""
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
    """Make a package of a system's files that are in no archive; `files` by the names that the structure uses."""
    sizes = {name: path.stat().st_size for name, path in files.items()}
    return Package(file, sha256(file) if file.is_file() else "", sizes, structure, form, scheme, files, unsaid)


def read_package(file: Path) -> Package:
    """Read the structure of an SSP archive."""
    # unlike Path.is_file, os.path.isfile does not raise for a name that is too long
    if not os.path.isfile(file):
        raise InputRefused(f"{file}: no such SSP")
    sizes = entries(file, "SSP")
    if STRUCTURE_FILE not in sizes:
        raise InputRefused(f"{file}: no {STRUCTURE_FILE} inside; this is not an SSP")

    def load_resource(source: str, what: str) -> Resource:
        entry = entry_of(source, sizes, STRUCTURE_FILE)
        if not entry:
            raise InputRefused(f"{file}: {what}: '{source}' is not a file of this archive")
        return Resource(read_entry(file, entry, MAX_TEXT_BYTES), entry, f"{file}: {entry}")

    where = f"{file}: {STRUCTURE_FILE}"
    structure = structure_of(read_entry(file, STRUCTURE_FILE, MAX_STRUCTURE_SIZE), where, load_resource)
    return Package(file, sha256(file), sizes, structure, scheme=_scheme(structure, where))


def _scheme(structure: Structure, where: str) -> Scheme:
    for note in structure.system.annotations:
        if note.type == SCHEME_ANNOTATION and note.content:
            name = parse_xml(note.content.encode(), f"{where}: annotation {SCHEME_ANNOTATION}").get("name", "")
            if name not in get_args(Scheme):
                known = " or ".join(get_args(Scheme))
                raise InputRefused(f"{where}: annotation {SCHEME_ANNOTATION}: '{name}'; expected {known}")
            return cast(Scheme, name)
    return "gauss_seidel"
