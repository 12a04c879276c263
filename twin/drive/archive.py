"""The FMU as a file: hashed, its archive checked for tricks and damage."""

import hashlib
import stat
import zipfile
import zlib
from pathlib import Path, PurePosixPath

from twin.errors import InputRefused

MOST_ENTRIES = 10_000
MOST_BYTES = 2 << 30
SUSPICIOUS_RATIO = 200
"""No honest FMU of more than a few MB shrinks to a 200th; a zip bomb does."""
FEW_BYTES = 64 << 20


def sha256(file: Path) -> str:
    """Of the file's bytes, in hexadecimal."""
    with file.open("rb") as stream:
        return hashlib.file_digest(stream, "sha256").hexdigest()


def entries(file: Path) -> dict[str, int]:
    """Names in the archive and their sizes unpacked, after checking that unpacking is safe and the archive whole.

    Raises:
        InputRefused: no zip, damaged, an entry that points outside or is a link, too many or too large entries.
    """
    try:
        with zipfile.ZipFile(file) as archive:
            infos = archive.infolist()
            if len(infos) > MOST_ENTRIES:
                raise InputRefused(
                    f"{file}: {len(infos)} entries; expected at most {MOST_ENTRIES}, do not trust this file"
                )
            size = sum(info.file_size for info in infos)
            packed = sum(info.compress_size for info in infos)
            if size > MOST_BYTES or (size > FEW_BYTES and size > SUSPICIOUS_RATIO * packed):
                raise InputRefused(
                    f"{file}: would expand from {packed / 1e6:.1f} to {size / 1e6:.0f} MB; do not trust this file"
                )
            for info in infos:
                _refuse_escape(file, info)
            damaged = archive.testzip()
            if damaged:
                raise InputRefused(f"{file}: entry '{damaged}' is damaged; get the FMU again")
            return {place(info): info.file_size for info in infos}
    except (zipfile.BadZipFile, zlib.error, EOFError, NotImplementedError, RuntimeError) as problem:
        raise InputRefused(f"{file}: not a complete FMU, {str(problem).lower()}; an FMU is a zip archive") from None


def place(info: zipfile.ZipInfo) -> str:
    """Where an entry belongs, below the folder it is unpacked to: some tools write Windows' separators."""
    return info.filename.replace("\\", "/")


def _refuse_escape(file: Path, info: zipfile.ZipInfo) -> None:
    name = place(info)
    if name.startswith("/") or ".." in PurePosixPath(name).parts or ":" in name:
        raise InputRefused(f"{file}: entry '{name}' points outside the archive; do not trust this file")
    if stat.S_ISLNK(info.external_attr >> 16):
        raise InputRefused(f"{file}: entry '{name}' is a link; do not trust this file")
