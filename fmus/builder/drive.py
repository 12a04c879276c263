"""A drive, or another part, as its folder describes it: variables, sources and the GUID that ties them to a binary."""

import hashlib
import math
import sys
import tomllib
import uuid
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

FMUS = Path(__file__).resolve().parents[1]
FMI2 = FMUS / "fmi2"
FMI3 = FMUS / "fmi3"
PARTS = FMUS / "parts"
FLOAT32_MAX = 3.4028234663852886e38
TYPE_BOUNDS = {"Float32": (-FLOAT32_MAX, FLOAT32_MAX), "Int32": (-(2.0**31), 2.0**31 - 1), "Boolean": (0.0, 1.0)}
GUID_NAMESPACE = uuid.UUID("6f1d4c1e-6d0a-5c0b-9f0e-7d2b1a4c8e35")


@dataclass(frozen=True)
class Variable:
    """One `[[variable]]` of drive.toml.

    In FMI 2.0 drives a Real ScalarVariable (section 2.2.7); in FMI 3.0 drives of one of the types Float64, Float32,
    Int32, Boolean (section 2.4.7), of which the last two have no unit. `whole`: a number without a
    fraction, as that of a kind is; `min = -inf` or `max = inf`: it may be infinite in a saved state.
    """

    name: str
    causality: str
    variability: str
    start: float
    description: str
    unit: str | None = None
    type: str = "Float64"
    initial: str | None = None
    min: float | None = None
    max: float | None = None
    whole: bool = False

    @property
    def is_whole(self) -> bool:
        """Whether values have no fraction: kinds, counts, and all of an integer type."""
        return self.whole or (self.type in TYPE_BOUNDS and self.type != "Float32")

    @property
    def bounds(self) -> tuple[float, float]:
        """Smallest and largest value; finite unless `min` or `max` is infinite."""
        low, high = TYPE_BOUNDS.get(self.type, (-sys.float_info.max, sys.float_info.max))
        return low if self.min is None else float(self.min), high if self.max is None else float(self.max)

    @property
    def stated_bounds(self) -> dict[str, float]:
        """Attributes `min` and `max` for modelDescription.xml, where they are given and finite."""
        given = {"min": self.min, "max": self.max}
        return {name: float(value) for name, value in given.items() if value is not None and math.isfinite(value)}


@dataclass(frozen=True)
class Drive:
    """A drive's folder, read. The position in `variables` is the value reference.

    Attributes:
        name: of the folder.
        description: one sentence.
        variables: in the order of drive.toml.
        sources: the files the binary is made of.
        guid: of `sources`; FMI 3.0 calls it the instantiation token.
        fmi: version of the standard, "2.0" or "3.0".
        units: that fmi2/units.toml lacks, as it writes them.
    """

    name: str
    description: str
    variables: tuple[Variable, ...]
    sources: tuple[Path, ...]
    guid: str
    fmi: str = "2.0"
    units: dict[str, dict[str, float]] = field(default_factory=dict)


def drive_names(fmi: str = "2.0") -> list[str]:
    """Names of the drives compiled from a drive.toml for this version of FMI, sorted."""
    return sorted(path.parent.name for path in FMUS.glob("*/drive.toml") if _document(path)["fmi"] == fmi)


def part_names() -> list[str]:
    """Names of the other parts of the robot, compiled from a part.toml, sorted."""
    return sorted(path.parent.name for path in PARTS.glob("*/part.toml"))


def folder_of(name: str) -> Path:
    """Where the drive, or the other part, `name` is described and built."""
    return PARTS / name if (PARTS / name).is_dir() else FMUS / name


def load_drive(name: str) -> Drive:
    """The drive, or the other part, in folder `name`.

    Raises:
        FileNotFoundError: there is no such drive.
        KeyError: it gives a start value to a variable that it has not.
        TypeError: a variable has an unknown key or lacks a required one.
    """
    folder = folder_of(name)
    table = folder / ("part.toml" if folder.parent == PARTS else "drive.toml")
    document = _document(table)
    fmi, rows = document["fmi"], document.get("variable", [])
    more = sorted({*folder.glob("*.[ch]")} - {folder / "model.c"})
    sources = (table, folder / "model.c", *more, *ceremony(fmi))
    if "like" in document:
        shared = FMUS / document["like"]
        sources = (table, shared / "variables.toml", shared / "model.c", *ceremony(fmi))
        rows = _started(_document(shared / "variables.toml")["variable"], document["start"])
    return Drive(
        name=name,
        description=document["description"],
        variables=tuple(variable for row in rows for variable in _variables(**row)),
        sources=sources,
        guid=source_guid(sources),
        fmi=fmi,
        units=document.get("units", {}),
    )


def _variables(name: str, copies: int = 0, **row: Any) -> list[Variable]:
    """The variable of a row; with `copies` NAME_1 .. NAME_copies."""
    names = [f"{name}_{number}" for number in range(1, copies + 1)] or [name]
    return [Variable(name=each, **row) for each in names]


def ceremony(fmi: str) -> list[Path]:
    """The files every drive of this version of FMI shares, sorted; FMI 3.0 borrows the model's interface."""
    if fmi == "3.0":
        return sorted([*(path for path in FMI3.iterdir() if path.is_file()), FMI2 / "model.h"])
    return sorted(path for path in FMI2.iterdir() if path.is_file())


def _started(rows: list[dict[str, Any]], starts: dict[str, float]) -> list[dict[str, Any]]:
    """The variables that drives share, with the start values of one."""
    places = {row["name"]: n for n, row in enumerate(rows)}
    rows = list(rows)
    for name, start in starts.items():
        rows[places[name]] = rows[places[name]] | {"start": start}
    return rows


def _document(path: Path) -> dict[str, Any]:
    """drive.toml at `path`; one that names no version of FMI is of 2.0."""
    return {"fmi": "2.0"} | tomllib.loads(path.read_text(encoding="utf-8"))


def source_guid(sources: tuple[Path, ...]) -> str:
    """GUID made of the sources' names and contents, so that a stale binary is recognised without a compiler."""
    digest = hashlib.sha256()
    for path in sources:
        content = path.read_bytes()
        digest.update(f"{path.name} {len(content)}\n".encode())
        digest.update(content)
    return "{" + str(uuid.uuid5(GUID_NAMESPACE, digest.hexdigest())) + "}"
