"""A drive as its folder describes it: variables, sources and the GUID that ties them to a binary."""

import hashlib
import tomllib
import uuid
from dataclasses import dataclass
from pathlib import Path

FMUS = Path(__file__).resolve().parents[1]
FMI2 = FMUS / "fmi2"
GUID_NAMESPACE = uuid.UUID("6f1d4c1e-6d0a-5c0b-9f0e-7d2b1a4c8e35")


@dataclass(frozen=True)
class Variable:
    """One `[[variable]]` of drive.toml: a Real ScalarVariable of FMI 2.0 (section 2.2.7) in SI units."""

    name: str
    causality: str
    variability: str
    start: float
    unit: str
    description: str
    initial: str | None = None
    min: float | None = None
    max: float | None = None


@dataclass(frozen=True)
class Drive:
    """A drive's folder, read. The position in `variables` is the value reference."""

    name: str
    description: str
    variables: tuple[Variable, ...]
    sources: tuple[Path, ...]
    guid: str


def drive_names() -> list[str]:
    """Names of all drives, sorted: the folders that hold a drive.toml."""
    return sorted(path.parent.name for path in FMUS.glob("*/drive.toml"))


def load_drive(name: str) -> Drive:
    """The drive in folder `name`.

    Raises:
        FileNotFoundError: there is no such drive.
        TypeError: a variable has an unknown key or lacks a required one.
    """
    folder = FMUS / name
    document = tomllib.loads((folder / "drive.toml").read_text(encoding="utf-8"))
    sources = (folder / "drive.toml", folder / "model.c", *sorted(p for p in FMI2.iterdir() if p.is_file()))
    return Drive(
        name=name,
        description=document["description"],
        variables=tuple(Variable(**row) for row in document["variable"]),
        sources=sources,
        guid=source_guid(sources),
    )


def source_guid(sources: tuple[Path, ...]) -> str:
    """GUID made of the sources' names and contents, so that a stale binary can be told without a compiler."""
    digest = hashlib.sha256()
    for path in sources:
        content = path.read_bytes()
        digest.update(f"{path.name} {len(content)}\n".encode())
        digest.update(content)
    return "{" + str(uuid.uuid5(GUID_NAMESPACE, digest.hexdigest())) + "}"
