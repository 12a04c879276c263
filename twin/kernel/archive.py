"""FMU and SSP archives: zip files, checked for attacks and damage before any content is used."""

import hashlib
import io
import posixpath
import re
import stat
import zipfile
import zlib
from collections.abc import Mapping
from pathlib import Path, PurePosixPath
from urllib.parse import unquote

from twin.kernel.errors import InputRefused
from twin.kernel.files import MAX_TEXT_BYTES

MAX_ENTRIES = 10_000
MAX_UNPACKED_BYTES = 2 << 30
SUSPICIOUS_RATIO = 200
"""Compression ratio of a zip bomb; FMUs of more than a few MB do not reach it."""
MIN_SUSPICIOUS_BYTES = 64 << 20
ZIP_EPOCH = (1980, 1, 1, 0, 0, 0)
"""Earliest date of a zip entry; the actual date would make every build a different file."""


def sha256(file: Path) -> str:
    """Return the SHA-256 of a file as hex."""
    with file.open("rb") as stream:
        return hashlib.file_digest(stream, "sha256").hexdigest()


def entries(file: Path, kind: str = "FMU") -> dict[str, int]:
    """Check that an archive is undamaged and safe to unpack, and return its entry names and unpacked sizes (bytes)."""
    try:
        with zipfile.ZipFile(file) as archive:
            infos = archive.infolist()
            if len(infos) > MAX_ENTRIES:
                raise InputRefused(
                    f"{file}: {len(infos)} entries; expected at most {MAX_ENTRIES}, do not trust this file"
                )
            size = sum(info.file_size for info in infos)
            packed = sum(info.compress_size for info in infos)
            if size > MAX_UNPACKED_BYTES or (size > MIN_SUSPICIOUS_BYTES and size > SUSPICIOUS_RATIO * packed):
                raise InputRefused(
                    f"{file}: would expand from {packed / 1e6:.1f} to {size / 1e6:.0f} MB; do not trust this file"
                )
            for info in infos:
                name = entry_path(info)
                if name.startswith("/") or ".." in PurePosixPath(name).parts or ":" in name:
                    raise InputRefused(f"{file}: entry '{name}' points outside the archive; do not trust this file")
                if stat.S_ISLNK(info.external_attr >> 16):
                    raise InputRefused(f"{file}: entry '{name}' is a link; do not trust this file")
            if damaged := archive.testzip():
                raise InputRefused(f"{file}: entry '{damaged}' is damaged; get the {kind} again")
            return {entry_path(info): info.file_size for info in infos}
    except (zipfile.BadZipFile, zlib.error, EOFError, NotImplementedError, RuntimeError) as problem:
        raise InputRefused(
            f"{file}: not a complete {kind}, {str(problem).lower()}; an {kind} is a zip archive"
        ) from None


def entry_path(info: zipfile.ZipInfo) -> str:
    """Return the file path of an archive entry below the folder that the archive is unpacked to."""
    return info.filename.replace("\\", "/")


def entry_of(source: str, names: dict[str, int], base: str) -> str:
    """Resolve a relative URI in the entry `base` to one of the entry names `names`; "" if it is not among them."""
    if re.match(r"[A-Za-z][A-Za-z0-9+.-]*:|/", source):
        return ""
    path = unquote(re.split(r"[?#]", source)[0])
    # a path that leads out of the archive is not among its entries
    name = posixpath.normpath(posixpath.join(posixpath.dirname(base), path))
    return name if name in names else ""


def read_entry(file: Path, entry: str, limit: int = MAX_TEXT_BYTES) -> bytes:
    """Read the content of an entry of the archive `file`, which `entries` must have accepted."""
    with zipfile.ZipFile(file) as archive:
        info = next(info for info in archive.infolist() if entry_path(info) == entry)
        if info.file_size > limit:
            raise InputRefused(
                f"{file}: {entry}: {info.file_size / 2**20:.0f} MB; expected at most {limit / 2**20:g} MB"
            )
        return archive.read(info)


def zip_bytes(entries: Mapping[str, bytes]) -> bytes:
    """Build a zip from contents by name; the same contents give the same bytes."""
    file = io.BytesIO()
    with zipfile.ZipFile(file, "w") as packing:
        for name, content in sorted(entries.items()):
            entry = zipfile.ZipInfo(name, date_time=ZIP_EPOCH)
            entry.compress_type = zipfile.ZIP_DEFLATED
            entry.external_attr = 0o644 << 16
            packing.writestr(entry, content)
    return file.getvalue()
