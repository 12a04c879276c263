"""A system of FMUs as other tools write it down: an SSP archive (SSP 1.0), its parts and what leads where."""

import xml.etree.ElementTree as ET
import zipfile
from pathlib import Path, PurePosixPath
from typing import NamedTuple

from twin.archive import entries, place
from twin.errors import InputRefused
from twin.files import xml_of

STRUCTURE = "SystemStructure.ssd"
MOST_STRUCTURE = 16 << 20
MOST_FMU = 512 << 20
"""Bytes, unpacked of the structure, packed of an FMU."""
MOST_PARTS = 50
NAMESPACE = "{http://ssp-standard.org/SSP1/SystemStructureDescription}"


class Connection(NamedTuple):
    """What leads from an output to an input, "part.variable" each, and why twin cannot do as it says; "" if it can."""

    source: str
    target: str
    objection: str = ""


class SystemStructure(NamedTuple):
    """A system of FMUs.

    Attributes:
        parts: FMUs' entries in the archive, by part.
        connections: between parts; those with the system's own connectors are left out.
    """

    parts: dict[str, str]
    connections: tuple[Connection, ...]


def structure(file: Path) -> SystemStructure:
    """What the SSP archive `file` says.

    Raises:
        InputRefused: no whole SSP, no readable structure, or a part that is no FMU inside.
    """
    sizes = entries(file)
    if STRUCTURE not in sizes:
        raise InputRefused(f"{file}: no {STRUCTURE} inside; this is not an SSP")
    root = xml_of(_content(file, STRUCTURE, MOST_STRUCTURE), f"{file}: {STRUCTURE}")
    system = root.find(f"{NAMESPACE}System")
    if system is None:
        raise InputRefused(f"{file}: {STRUCTURE} has no system of SSP 1.0")
    found = system.findall(f"{NAMESPACE}Elements/*")
    if not found or len(found) > MOST_PARTS:
        raise InputRefused(f"{file}: {len(found)} parts; expected 1 to {MOST_PARTS}")
    parts = {element.get("name", ""): _source(file, element, sizes) for element in found}
    connections = [c for element in system.findall(f"{NAMESPACE}Connections/*") if (c := _connection(element))]
    return SystemStructure(parts, tuple(connections))


def fmu_content(file: Path, entry: str) -> bytes:
    """The FMU that is an `entry` of the SSP archive `file`.

    Raises:
        InputRefused: it is too large.
    """
    return _content(file, entry, MOST_FMU)


def _content(file: Path, entry: str, most: int) -> bytes:
    with zipfile.ZipFile(file) as archive:
        info = next(info for info in archive.infolist() if place(info) == entry)
        if info.file_size > most:
            raise InputRefused(f"{file}: {entry} has {info.file_size / 1e6:.0f} MB; do not trust this file")
        return archive.read(info)


def _source(file: Path, element: ET.Element, sizes: dict[str, int]) -> str:
    """The entry of an element's FMU."""
    name, source = element.get("name"), element.get("source", "")
    entry = str(PurePosixPath(source))
    if element.tag != f"{NAMESPACE}Component" or not name or entry not in sizes or not entry.endswith(".fmu"):
        raise InputRefused(
            f"{file}: part '{name}' is no FMU inside this archive ({source or 'a system of its own'}); put the FMUs "
            "into one folder and name them all"
        )
    return entry


def _connection(element: ET.Element) -> Connection | None:
    ends = [element.get(f"{end}{what}") for end in ("start", "end") for what in ("Element", "Connector")]
    # without an element it is a connector of the system itself
    if not all(ends):
        return None
    scaled = [child.tag.rpartition("}")[2] for child in element if child.tag.endswith("Transformation")]
    return Connection(f"{ends[0]}.{ends[1]}", f"{ends[2]}.{ends[3]}", f"it has a {scaled[0]}" if scaled else "")
