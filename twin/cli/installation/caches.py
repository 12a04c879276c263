"""What is kept between commands because it takes time to make: compiled code and unpacked FMUs."""

import os
from collections.abc import Sequence
from pathlib import Path

from twin.cli.installation.finding import Finding
from twin.compiled.store import VARIABLE, damaged_files, folder, object_files, refusal
from twin.drive.unpacked import shelf
from twin.errors import InputRefused

SAFE = "which only you can write to"


def compiled_finding() -> Finding:
    """Whether what is compiled can be kept, is there already, and is as it was written."""
    if refusal():
        return Finding("compiled", "lacks", f"every command compiles anew: {refusal()}")
    place = f"{folder()}, {f'as {VARIABLE} says' if os.environ.get(VARIABLE) else SAFE}"
    files = object_files()
    if not files:
        return Finding("compiled", "ok", f"nothing yet: the first run compiles, some seconds; kept in {place}")
    size = sum(file.stat().st_size for file in files)
    return Finding("compiled", "ok", f"{size / 1e6:.0f} MB kept in {place}{_told(damaged_files(), 'compiled again')}")


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
