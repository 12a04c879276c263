"""The .fmu file: a zip whose bytes depend on nothing but its content."""

import zipfile
from collections.abc import Iterable
from pathlib import Path

from .compile import shared_library, write_generated
from .drive import FMUS, Drive
from .model_description import model_description

# the earliest date a zip can hold; the true date would make every build different
EPOCH = (1980, 1, 1, 0, 0, 0)


def write_fmu(drive: Drive, platforms: Iterable[str], scratch: Path, target: Path) -> None:
    """Build the drive for the platforms (keys of TARGETS) under `scratch` and pack it into `target`.

    Raises:
        subprocess.CalledProcessError: the compiler refused.
        KeyError: a variable has a unit that fmi2/units.toml does not define.
    """
    write_generated(drive, scratch)
    (scratch / "modelDescription.xml").write_bytes(model_description(drive))
    entries = {"modelDescription.xml": scratch / "modelDescription.xml"}
    for platform in platforms:
        library = shared_library(drive, platform, scratch)
        entries[f"binaries/{platform}/{library.name}"] = library
    for source in (*drive.sources, scratch / "variables.h", scratch / "variables.c"):
        entries[f"sources/{source.name}"] = source
    entries["documentation/README.md"] = FMUS / drive.name / "README.md"
    _write_zip(target, entries)


def _write_zip(target: Path, entries: dict[str, Path]) -> None:
    with zipfile.ZipFile(target, "w") as archive:
        for name, path in sorted(entries.items()):
            entry = zipfile.ZipInfo(name, date_time=EPOCH)
            entry.compress_type = zipfile.ZIP_DEFLATED
            entry.external_attr = 0o644 << 16
            archive.writestr(entry, path.read_bytes())
