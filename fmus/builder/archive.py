"""The .fmu file: a zip whose bytes depend on nothing but its content."""

import zipfile
from collections.abc import Iterable
from pathlib import Path

from .compile import shared_library, write_generated
from .drive import Drive, folder_of
from .model_description import model_description
from .model_description_fmi3 import model_description_fmi3

# the earliest date a zip can hold; the true date would make every build different
EPOCH = (1980, 1, 1, 0, 0, 0)


def write_fmu(drive: Drive, platforms: Iterable[str], scratch: Path, target: Path) -> None:
    """Build the drive for the platforms (keys of TARGETS, or of TARGETS_FMI3) under `scratch`, pack it into `target`.

    Raises:
        subprocess.CalledProcessError: the compiler refused.
        KeyError: a variable has a unit that fmi2/units.toml does not define.
    """
    write_generated(drive, scratch)
    describe = {"2.0": model_description, "3.0": model_description_fmi3}[drive.fmi]
    (scratch / "modelDescription.xml").write_bytes(describe(drive))
    entries = {"modelDescription.xml": scratch / "modelDescription.xml"}
    for platform in platforms:
        library = shared_library(drive, platform, scratch)
        entries[f"binaries/{platform}/{library.name}"] = library
    for source in (*drive.sources, scratch / "variables.h", scratch / "variables.c"):
        entries[f"sources/{source.name}"] = source
    readme = folder_of(drive.name) / "README.md"
    if readme.is_file():
        entries["documentation/README.md"] = readme
    write_zip(target, entries)


def write_zip(target: Path, entries: dict[str, Path]) -> None:
    """Pack files by their name in the archive; the same content gives the same bytes."""
    write_entries(target, {name: path.read_bytes() for name, path in entries.items()})


def write_entries(target: Path, entries: dict[str, bytes]) -> None:
    """The same of contents."""
    with zipfile.ZipFile(target, "w") as archive:
        for name, content in sorted(entries.items()):
            entry = zipfile.ZipInfo(name, date_time=EPOCH)
            entry.compress_type = zipfile.ZIP_DEFLATED
            entry.external_attr = 0o644 << 16
            archive.writestr(entry, content)
