"""What is kept between commands because it takes time to make: compiled code and unpacked FMUs."""

import os
from collections.abc import Sequence
from pathlib import Path

from twin.cache_folder import files_below
from twin.cli.installation.finding import Finding
from twin.cli.installation.native import compiled_folder, compiled_pieces
from twin.compiled.cache import is_own, refusal
from twin.compiled.seal import damaged_files
from twin.drive.unpacked import shelf
from twin.errors import InputRefused

SAFE = "which only you can write to"


def compiled_finding() -> Finding:
    """Whether what numba compiles can be kept, is there already, and is as it was written."""
    folder = compiled_folder()
    if refusal():
        return Finding("compiled", "lacks", f"every command compiles anew: {refusal()}")
    if not os.access(folder, os.W_OK):
        return Finding("compiled", "lacks", f"{folder} cannot be written: every run compiles anew; set NUMBA_CACHE_DIR")
    own = is_own(folder)
    place = f"{folder}, {SAFE if own else 'as NUMBA_CACHE_DIR says'}"
    if not compiled_pieces():
        return Finding("compiled", "ok", f"nothing yet: the first run compiles, some seconds; kept in {place}")
    size = sum(file.stat().st_size for file in files_below(folder) if file.is_file())
    damaged = damaged_files(folder) if own else []
    return Finding("compiled", "ok", f"{size / 1e6:.0f} MB kept in {place}{_told(damaged, 'compiled again')}")


def unpacked_finding() -> Finding:
    """Whether FMUs can be unpacked, and whether those that are unpacked are as they were."""
    try:
        kept = shelf()
    except InputRefused as refused:
        return Finding("unpacked", "bad", f"no drive can be unpacked: {refused}")
    place = f"{kept.folder}, {SAFE}{_told(kept.changed, 'taken from the FMU again')}"
    return Finding("unpacked", "ok", f"{kept.drives} FMUs, {kept.size / 1e6:.0f} MB, in {place}")


def _told(damaged: Sequence[Path], remedy: str) -> str:
    if not damaged:
        return ""
    return f"; {len(damaged)} changed since ({damaged[0].name}), {remedy} when needed"
