"""Files by content on a machine of the cluster: whatever has once arrived is never sent there again."""

import hashlib
import os
import shutil
import tempfile
from collections.abc import Iterable, Mapping
from pathlib import Path

from twin.cache_folder import cache_folder, discard_foreign
from twin.errors import InputRefused, disk_refusals


def home() -> Path:
    """Where they are kept: beside the unpacked FMUs.

    Raises:
        InputRefused: see `cache_folder`.
    """
    return cache_folder("parcels")


def missing(digests: Iterable[str]) -> list[str]:
    """Which of the SHA-256 `digests` are not here; what is here and damaged, or not the user's own, is thrown away."""
    return [digest for digest in dict.fromkeys(digests) if not _is_whole(home() / digest, digest)]


def keep(contents: Mapping[str, bytes]) -> None:
    """Write `contents`, by SHA-256; none is ever seen half-written.

    Raises:
        InputRefused: one is not what its hash says, or cannot be written.
    """
    folder = home()
    with disk_refusals(folder, kind=InputRefused, remedy="set TWIN_CACHE there"):
        for digest, content in contents.items():
            if hashlib.sha256(content).hexdigest() != digest:
                raise InputRefused(f"{digest}: was damaged on its way; give the same command again")
            with tempfile.NamedTemporaryFile(dir=folder, prefix=f".{digest[:12]}-", delete=False) as scratch:
                scratch.write(content)
            os.replace(scratch.name, folder / digest)


def lay_out(files: Mapping[str, str], folder: Path) -> None:
    """Make `files`, path -> SHA-256, appear in `folder`; all of them are here, see `missing`."""
    for inside, digest in files.items():
        path = folder / inside
        path.parent.mkdir(parents=True, exist_ok=True)
        # no symbolic link: an experiment looks for its files where its own file really is
        try:
            path.hardlink_to(home() / digest)
        except OSError:
            shutil.copyfile(home() / digest, path)


def _is_whole(file: Path, digest: str) -> bool:
    try:
        # another user could change it after this
        discard_foreign(file)
        with file.open("rb") as stream:
            whole = hashlib.file_digest(stream, "sha256").hexdigest() == digest
    except FileNotFoundError:
        return False
    if not whole:
        file.unlink(missing_ok=True)
    return whole
