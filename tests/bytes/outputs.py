"""What lies in a folder afterwards: recordings topic by topic, archives member by member, texts without moments."""

import hashlib
import io
import zipfile
from collections.abc import Callable
from pathlib import Path
from typing import Any

from tests.bytes.recording import digests

ARCHIVES = (".fmu", ".ssp", ".zip")
MACHINE_CODE = (".so", ".a", ".o", ".dll", ".lib", ".dylib")
TEXTS = (".json", ".jsonl", ".toml", ".csv", ".txt", ".md", ".c", ".h", ".xml", ".html", ".svg", ".ssd", ".ssv", ".py")
ERROR = " [error]"
"""How the name of what a command wrote to its error stream ends."""
EXCLUDED = ("metadata versions",)
"""What recordings say that need not be the same."""
LONGEST = 4_000_000
"""Characters of a text that is kept; longer ones have to be the same to the last moment in them."""


def described(folder: Path, placed: Callable[[str], str]) -> dict[str, Any]:
    """What lies below `folder`, by its path; no machine code, and no link.

    Args:
        placed: a text with names in place of the folders that it is made in.
    """
    found: dict[str, Any] = {}
    for path in sorted(folder.rglob("*")) if folder.is_dir() else ():
        if path.is_file() and not path.is_symlink():
            found |= _file(str(path.relative_to(folder)), path, placed)
    return found


def _file(name: str, path: Path, placed: Callable[[str], str]) -> dict[str, Any]:
    if path.suffix == ".mcap":
        try:
            parts = digests(path)
        except (ValueError, KeyError) as mistake:
            return {name: placed(f"{type(mistake).__name__}: {mistake}")}
        return {
            f"{name} {part}": placed(value) if isinstance(value, str) else value
            for part, value in parts.items()
            if part not in EXCLUDED
        }
    return _content(name, path.read_bytes(), placed)


def _content(name: str, content: bytes, placed: Callable[[str], str]) -> dict[str, Any]:
    """What `content` is, by `name`; of an archive each of its members."""
    if name.endswith(MACHINE_CODE):
        return {}
    if name.endswith(ARCHIVES):
        with zipfile.ZipFile(io.BytesIO(content)) as archive:
            found: dict[str, Any] = {}
            for member in archive.infolist():
                found |= _content(f"{name}/{member.filename}", archive.read(member), placed)
            return found
    if name.endswith(TEXTS):
        text = placed(content.decode("utf-8", "replace"))
        if len(text) <= LONGEST:
            return {name: text}
        content = text.encode()
    return {name: f"sha256 {hashlib.sha256(content).hexdigest()}"}
