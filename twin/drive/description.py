"""Reads an FMU without loading it, and refuses what cannot work before a binary is touched."""

import math
import platform as machine
import sys
import time
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path, PurePosixPath
from typing import Any, Literal

from fmpy import platform, read_model_description, sharedLibraryExtension

from twin.drive.adapter import KINDS
from twin.drive.archive import entries, sha256
from twin.drive.units import Conversion, conversion
from twin.errors import InputRefused, nearest

DESCRIPTION = "modelDescription.xml"
MOST_DESCRIPTION = 64 << 20
"""Bytes. The largest honest ones have tens of thousands of variables and some 10 MB."""

Kind = Literal["co_simulation", "model_exchange"]
KIND_NAMES: dict[Kind, str] = {"co_simulation": "co-simulation", "model_exchange": "model exchange"}
"""What an FMU is used as, and how people call that; the first is taken where nothing is said and both are offered."""

FMI2_KINDS = {"Real": "Float64", "Integer": "Int32", "Boolean": "Int32", "Enumeration": "Int32"}
FMI3_KINDS = {"Enumeration": "Int64"}
"""How types travel that have no functions of their own, in words of FMI 3.0."""

SETTLED = 2_000_000_000
"""Age (ns) from which a file's times tell it from every later state of it: the coarsest file system clock, FAT's."""


@dataclass(frozen=True)
class Variable:
    """A variable of an FMU.

    Attributes:
        name, causality, description: as the FMU has them.
        type: as the FMU has it, "Real" or "Float64".
        kind: index into `adapter.KINDS`; -1: text or binary.
        reference: FMI value reference.
        size: number of values, > 1 for an array.
        unit: as the FMU has it, "" where it states none.
        conversion: to SI; None: unit unknown or not stated.
        start, low, high: as the FMU has them, in its own unit; NaN: not stated.
    """

    name: str
    causality: str
    description: str
    type: str
    kind: int
    reference: int
    size: int
    unit: str
    conversion: Conversion | None
    start: float
    low: float
    high: float


@dataclass(frozen=True)
class FmuDescription:
    """An FMU that has passed every check that needs no binary.

    Attributes:
        path: the .fmu file.
        sha256: of its bytes.
        version: 2 or 3, FMI's.
        kind: as which it is used.
        identifier: of the binary.
        platforms: folders of binaries inside.
        variables: by name.
        model: what FMPy read.
    """

    path: Path
    sha256: str
    version: int
    kind: Kind
    identifier: str
    platforms: tuple[str, ...]
    variables: dict[str, Variable]
    model: Any

    @property
    def interface(self) -> Any:
        """What it says of itself as an FMU of its `kind`."""
        return _interface(self.model, self.kind)

    @property
    def standard(self) -> str:
        """What it is made to, for people; of kinds only the one that is not the usual is told."""
        usual = self.kind == "co_simulation"
        return f"FMI {self.model.fmiVersion}" + ("" if usual else f" {KIND_NAMES[self.kind]}")

    @property
    def kinds(self) -> tuple[Kind, ...]:
        """All that it can be used as."""
        return _kinds(self.model)

    def offered(self, causality: str) -> list[Variable]:
        """Numeric variables of a causality, in the FMU's order."""
        return [v for v in self.variables.values() if v.causality == causality and v.kind >= 0]

    def settings(self, values: Mapping[str, float]) -> Sequence[tuple[Variable, float]]:
        """Values for parameters and inputs, before initialisation.

        Raises:
            InputRefused: an unknown name, a variable that cannot be set, a value outside min and max or not finite.
        """
        settable = {v.name: v for v in self.variables.values() if v.causality in ("parameter", "input") and v.kind >= 0}
        checked = []
        for name, value in values.items():
            if name not in settable:
                known = ", ".join(v.name for v in self.offered("parameter")) or "none"
                hint = nearest(name, settable, f"its parameters are {known}")
                raise InputRefused(f"{self.path}: no parameter '{name}'; {hint}")
            variable = settable[name]
            low = variable.low if not math.isnan(variable.low) else -math.inf
            high = variable.high if not math.isnan(variable.high) else math.inf
            if not (low <= value <= high and math.isfinite(value)):
                raise InputRefused(
                    f"{self.path}: parameter {name} = {value:g}: expected {low:g} .. {high:g} {variable.unit}".rstrip()
                )
            checked.append((variable, float(value)))
        return checked

    @property
    def tolerance(self) -> float | None:
        """The relative tolerance that it states for its solver (DefaultExperiment); None: none that is a number > 0."""
        stated = _number(getattr(self.model.defaultExperiment, "tolerance", None))
        return stated if 0.0 < stated < math.inf else None

    def warnings(self) -> list[str]:
        """What FMPy's validation finds; validators disagree with each other, so nothing here refuses the FMU."""
        from fmpy.validation import validate_fmu

        return [" ".join(problem.split()) for problem in validate_fmu(str(self.path))]


_known: dict[tuple[Path, Kind | None], tuple[tuple[int, ...], FmuDescription]] = {}
"""What `described` has found, and the state of the file in which it did."""


def described(file: Path, kind: Kind | None = None) -> FmuDescription:
    """Read and check the FMU `file`; once in a process, for as long as the file stays what it is.

    Args:
        file: the FMU.
        kind: as which it is to be used; None: co-simulation, or else what it offers.

    Raises:
        InputRefused: not a whole zip, no readable model description, not of FMI 2.0 or 3.0 or not of that kind, needs a
            tool, or no binary for this platform.
    """
    if not file.is_file():
        raise InputRefused(f"{file}: no such FMU")
    facts = file.stat()
    stamp = (facts.st_dev, facts.st_ino, facts.st_size, facts.st_mtime_ns, facts.st_ctime_ns)
    known, description = _known.get((file, kind), (None, None))
    if description is None or known != stamp:
        description = _read(file, kind)
        # the next change of a file that has just been written might get the same time
        if time.time_ns() - max(facts.st_mtime_ns, facts.st_ctime_ns) > SETTLED:
            _known[file, kind] = stamp, description
    return description


def _read(file: Path, kind: Kind | None) -> FmuDescription:
    names = entries(file)
    if names.get(DESCRIPTION, 0) > MOST_DESCRIPTION:
        raise InputRefused(f"{file}: {DESCRIPTION} has {names[DESCRIPTION] / 1e6:.0f} MB; do not trust this file")
    model = _model(file)
    version = model.fmiVersion
    if version not in ("2.0",) and not version.startswith("3."):
        raise InputRefused(f"{file}: FMI {version}; export it as FMI 2.0 or 3.0 for co-simulation")
    kind = _chosen(file, model, kind)
    interface = _interface(model, kind)
    if interface.needsExecutionTool:
        raise InputRefused(f"{file}: needs its authoring tool while running; export it self-contained")
    major = int(version[0])
    folder, identifier = _platform(major), interface.modelIdentifier
    binary = f"binaries/{folder}/{identifier}{sharedLibraryExtension}"
    platforms = sorted({PurePosixPath(n).parts[1] for n in names if n.startswith("binaries/") and n.count("/") > 1})
    if binary not in names:
        others = [PurePosixPath(n).name for n in names if n.startswith(f"binaries/{folder}/") and not n.endswith("/")]
        if others:
            raise InputRefused(
                f"{file}: its binary for this platform is {', '.join(others)}; by its modelIdentifier it has to be "
                f"called {PurePosixPath(binary).name}. Export it again"
            )
        raise InputRefused(
            f"{file}: no binary for this platform ({binary}); it has {', '.join(platforms) or 'none'}. "
            f"Export it for {folder}, or build it from its sources"
        )
    return FmuDescription(
        path=file,
        sha256=sha256(file),
        version=major,
        kind=kind,
        identifier=identifier,
        platforms=tuple(platforms),
        variables={v.name: _variable(v, model) for v in model.modelVariables},
        model=model,
    )


def _interface(model: Any, kind: Kind) -> Any:
    return model.coSimulation if kind == "co_simulation" else model.modelExchange


def _kinds(model: Any) -> tuple[Kind, ...]:
    return tuple(kind for kind in KIND_NAMES if _interface(model, kind) is not None)


def _chosen(file: Path, model: Any, kind: Kind | None) -> Kind:
    """`kind`, or the first that the FMU offers."""
    kinds = _kinds(model)
    if not kinds:
        raise InputRefused(
            f"{file}: FMI {model.fmiVersion} without co-simulation and model exchange; export it for co-simulation"
        )
    if kind is not None and kind not in kinds:
        raise InputRefused(
            f'{file}: offers {KIND_NAMES[kinds[0]]} alone; remove kind = "{kind}", or export it for {KIND_NAMES[kind]}'
        )
    return kind or kinds[0]


def _platform(major: int) -> str:
    """FMI's name of this platform's folder of binaries."""
    if major == 2:
        return platform
    system = {"linux": "linux", "darwin": "darwin", "win32": "windows"}.get(sys.platform, sys.platform)
    processor = {"AMD64": "x86_64", "arm64": "aarch64"}.get(machine.machine(), machine.machine())
    return f"{processor}-{system}"


def _model(file: Path) -> Any:
    try:
        return read_model_description(str(file), validate=False)
    except KeyError:
        raise InputRefused(f"{file}: no modelDescription.xml inside; this is not an FMU") from None
    # FMPy raises bare Exception and lxml its own family: whatever it says of this file is the reason
    except Exception as problem:
        raise InputRefused(f"{file}: modelDescription.xml cannot be read: {problem}") from None


def _variable(v: Any, model: Any) -> Variable:
    declared = v.declaredType
    unit = v.unit or (declared.unit if declared is not None else None) or ""
    # Boolean is a type of both standards, four bytes wide in the one and one in the other
    kind = (FMI2_KINDS if model.fmiVersion == "2.0" else FMI3_KINDS).get(v.type, v.type)
    size = 1
    for dimension in v.dimensions or ():
        size *= int(dimension.start) if dimension.start is not None else int(dimension.variable.start)
    return Variable(
        name=v.name,
        causality=v.causality or "local",
        description=v.description or "",
        type=v.type,
        kind=KINDS.index(kind) if kind in KINDS else -1,
        reference=v.valueReference,
        size=size,
        unit=unit,
        conversion=conversion(unit, model.unitDefinitions) if unit else None,
        start=_number(v.start),
        low=_number(v.min),
        high=_number(v.max),
    )


def _number(text: Any) -> float:
    if text in ("true", "false"):
        return float(text == "true")
    try:
        return float(text)
    except (TypeError, ValueError):
        return math.nan
