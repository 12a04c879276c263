"""What lies in a folder afterwards: recordings topic by topic, archives member by member, texts without moments."""

import hashlib
import io
import zipfile
from pathlib import Path
from typing import Any

from tests.bytes.normal import Normal
from tests.bytes.recording import digests

ARCHIVES = (".fmu", ".ssp", ".zip")
MACHINE_CODE = (".so", ".a", ".o", ".dll", ".lib", ".dylib")
TEXTS = (".json", ".jsonl", ".toml", ".csv", ".txt", ".md", ".c", ".h", ".xml", ".html", ".svg", ".ssd", ".ssv", ".py")
EXCLUDED = ("metadata versions",)
"""What recordings say that need not be the same."""
SHOWN = 20_000
"""Characters of a text that are kept to show where two part; of a longer one it is only known that they do."""


def described(folder: Path, normal: Normal) -> dict[str, Any]:
    """What lies below `folder`, by its path; no machine code, and no link."""
    found: dict[str, Any] = {}
    for path in sorted(folder.rglob("*")) if folder.is_dir() else ():
        if path.is_file() and not path.is_symlink():
            name = normal.text(str(path.relative_to(folder)))
            found |= _file(name, path, normal)
    return found


def _file(name: str, path: Path, normal: Normal) -> dict[str, Any]:
    if path.suffix == ".mcap":
        try:
            parts = digests(path)
        except (ValueError, KeyError) as mistake:
            return {name: normal.text(f"{type(mistake).__name__}: {mistake}")}
        return {
            f"{name} {part}": normal.text(value) if isinstance(value, str) else value
            for part, value in parts.items()
            if part not in EXCLUDED
        }
    return _content(name, path.read_bytes(), normal)


def _content(name: str, content: bytes, normal: Normal) -> dict[str, Any]:
    """What `content` is, by `name`; of an archive each of its members."""
    if name.endswith(MACHINE_CODE):
        return {}
    if name.endswith(ARCHIVES):
        with zipfile.ZipFile(io.BytesIO(content)) as archive:
            found: dict[str, Any] = {}
            for member in archive.infolist():
                found |= _content(f"{name}/{member.filename}", archive.read(member), normal)
            return found
    if name.endswith(TEXTS):
        text = normal.text(content.decode("utf-8", "replace"))
        if len(text) <= SHOWN:
            return {name: text}
        content = text.encode()
    return {name: f"sha256 {hashlib.sha256(content).hexdigest()}"}
