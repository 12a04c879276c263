"""FMU and SSP archives: zip files, checked for tricks and damage before any content is used."""

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
"""No honest FMU of more than a few MB shrinks to a 200th; a zip bomb does."""
MIN_SUSPICIOUS_BYTES = 64 << 20
ZIP_EPOCH = (1980, 1, 1, 0, 0, 0)
"""The earliest date that an archive can hold; the true one would make every build another file."""


def sha256(file: Path) -> str:
    """Of the file's bytes, in hexadecimal."""
    with file.open("rb") as stream:
        return hashlib.file_digest(stream, "sha256").hexdigest()


def entries(file: Path, kind: str = "FMU") -> dict[str, int]:
    """Names in the archive and their sizes unpacked, after checking that unpacking is safe and the archive whole.

    Args:
        kind: "FMU" or "SSP", for sentences.

    Raises:
        InputRefused: no zip, damaged, an entry that points outside or is a link, too many or too large entries.
    """
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
            damaged = archive.testzip()
            if damaged:
                raise InputRefused(f"{file}: entry '{damaged}' is damaged; get the {kind} again")
            return {entry_path(info): info.file_size for info in infos}
    except (zipfile.BadZipFile, zlib.error, EOFError, NotImplementedError, RuntimeError) as problem:
        raise InputRefused(
            f"{file}: not a complete {kind}, {str(problem).lower()}; an {kind} is a zip archive"
        ) from None


def entry_path(info: zipfile.ZipInfo) -> str:
    """Where an entry belongs, below the folder it is unpacked to: some tools write Windows' separators."""
    return info.filename.replace("\\", "/")


def entry_of(source: str, names: dict[str, int], base: str) -> str:
    """The entry among `names` that the relative URI `source` means; "": it is none of them.

    Args:
        base: entry in which the URI stands.
    """
    if re.match(r"[A-Za-z][A-Za-z0-9+.-]*:|/", source):
        return ""
    path = unquote(re.split(r"[?#]", source)[0])
    # what leads out of the archive is none of its entries
    name = posixpath.normpath(posixpath.join(posixpath.dirname(base), path))
    return name if name in names else ""


def read_entry(file: Path, entry: str, limit: int = MAX_TEXT_BYTES) -> bytes:
    """The content of an entry of the archive `file`, which `entries` has found sound.

    Raises:
        InputRefused: it has more than `limit` bytes.
    """
    with zipfile.ZipFile(file) as archive:
        info = next(info for info in archive.infolist() if entry_path(info) == entry)
        if info.file_size > limit:
            raise InputRefused(
                f"{file}: {entry}: {info.file_size / 2**20:.0f} MB; expected at most {limit / 2**20:g} MB"
            )
        return archive.read(info)


def zip_bytes(entries: Mapping[str, bytes]) -> bytes:
    """A zip of contents by name; the same contents give the same bytes."""
    file = io.BytesIO()
    with zipfile.ZipFile(file, "w") as packing:
        for name, content in sorted(entries.items()):
            entry = zipfile.ZipInfo(name, date_time=ZIP_EPOCH)
            entry.compress_type = zipfile.ZIP_DEFLATED
            entry.external_attr = 0o644 << 16
            packing.writestr(entry, content)
    return file.getvalue()
