"""A foreign drive brought in: the mapping.toml to start from, beside its FMUs."""

import os
from collections.abc import Sequence
from pathlib import Path
from typing import NamedTuple

from twin.cosim.ssp.package import Package, read_package
from twin.cosim.ssp.structure import Connection, SspComponent
from twin.cosim.ssp.unit import NONE
from twin.drive.description import described
from twin.errors import InputRefused
from twin.experiment.drive_files import MAPPING, lone_drive
from twin.files import open_regular
from twin.places import CARRIED
from twin.studies.qualify.parts_proposal import KnownWire, part_names, parts_proposal
from twin.studies.qualify.proposal import proposal
from twin.writing import made_folder, write_bytes, write_text

MOST_PARTS = 50
"""Of a drive."""


class Begun(NamedTuple):
    """A mapping that has been written, and whether it is complete as it is."""

    mapping: Path
    complete: bool


def begun(named: Sequence[str], start: Path) -> Begun:
    """Write the mapping of an FMU, of several that make one drive, or of the system in an SSP archive.

    It stands beside the first FMU; what is in an SSP is put into a folder of its name beside it. Of a drive that an
    installed twin carries a copy is put into a folder of its name here.

    Args:
        named: FMUs, as `lone_drive` takes them, or one SSP.
        start: folder from which names are looked up.

    Raises:
        InputRefused: a file cannot be used, or there is a mapping.
        NotWritten: the folder or the disk refuses.
    """
    if any(name.endswith(".ssp") for name in named):
        if len(named) > 1:
            raise InputRefused(f"{' '.join(named)}: an SSP is a whole drive; name it alone")
        return _from_system(Path(named[0]))
    files = [_own(_fmu(name, start)) for name in named]
    folder = files[0].parent
    mapping = _unwritten(folder)
    if len(files) == 1:
        return _written(mapping, *proposal(described(files[0])))
    parts = dict(zip(part_names(files), map(described, files), strict=True))
    return _written(mapping, *parts_proposal(parts, folder))


def _from_system(file: Path) -> Begun:
    package = read_package(file)
    entries = _fmu_entries(package)
    folder = file.with_suffix("")
    mapping = _unwritten(folder)
    made_folder(folder)
    names = dict(zip(entries, part_names(Path(part) for part in entries), strict=True))
    parts = {}
    for part, entry in entries.items():
        fmu = folder / f"{names[part]}.fmu"
        _put(fmu, package.content(entry))
        parts[names[part]] = described(fmu)
    wires = [wire for one in package.structure.system.connections if (wire := _known_wire(one, names))]
    return _written(mapping, *parts_proposal(parts, folder, wires))


def _fmu_entries(package: Package) -> dict[str, str]:
    """FMUs' entries in the archive, by part."""
    found = package.structure.system.elements
    if not found or len(found) > MOST_PARTS:
        raise InputRefused(f"{package.file}: {len(found)} parts; expected 1 to {MOST_PARTS}")
    entries = {}
    for part in found:
        source = part.source if isinstance(part, SspComponent) else ""
        entries[part.name] = package.entry(source)
        if not entries[part.name].endswith(".fmu"):
            raise InputRefused(
                f"{package.file}: part '{part.name}' is no FMU inside this archive "
                f"({source or 'a system of its own'}); put the FMUs into one folder and name them all"
            )
    return entries


def _known_wire(connection: Connection, names: dict[str, str]) -> KnownWire | None:
    """None: it is one with the system's own connectors."""
    ends = connection.start, connection.end
    if not all(end.element for end in ends):
        return None
    scaled = connection.transformation.table or "LinearTransformation" * (connection.transformation != NONE)
    source, target = (f"{names.get(end.element, end.element)}.{end.connector}" for end in ends)
    return KnownWire(source, target, f"it has a {scaled}" if scaled else "")


def _put(fmu: Path, content: bytes) -> None:
    if os.path.lexists(fmu):
        with open_regular(fmu, max(1, len(content))) as there:
            if there.read() == content:
                return
        raise InputRefused(f"{fmu}: exists, and is another file; move it away")
    write_bytes(fmu, content)


def _fmu(name: str, start: Path) -> Path:
    file = lone_drive(name, start).fmu
    if file is None:
        raise InputRefused(f"{name}: is made of several FMUs already; name .fmu files")
    return Path(file)


def _own(fmu: Path) -> Path:
    """`fmu`, or a copy of it in the current folder if it is part of an installation, which is not to be changed."""
    if not fmu.is_relative_to(CARRIED):
        return fmu
    copy = Path.cwd() / fmu.stem / fmu.name
    _unwritten(copy.parent)
    made_folder(copy.parent)
    _put(copy, fmu.read_bytes())
    return copy


def _unwritten(folder: Path) -> Path:
    """The mapping in `folder`, which is not there yet."""
    mapping = Path(os.path.relpath(folder / MAPPING))
    if os.path.lexists(mapping):
        raise InputRefused(f"{mapping}: exists, and is never overwritten; move it away for a new one")
    return mapping


def _written(mapping: Path, text: str, complete: bool) -> Begun:
    write_text(mapping, text)
    return Begun(mapping, complete)
