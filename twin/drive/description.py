"""Reads a drive FMU without loading it, and refuses what cannot work before a binary is touched."""

import difflib
import hashlib
import math
import zipfile
import zlib
from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path, PurePosixPath
from typing import Any

from fmpy import platform, read_model_description, sharedLibraryExtension

from twin.drive.contract import ROLES, Dimension, Role
from twin.errors import InputRefused


@dataclass(frozen=True)
class DriveDescription:
    """A drive FMU that has passed every check that needs no binary.

    Attributes:
        path: the .fmu file. sha256: of its bytes.
        roles: the roles it fills, inputs first, in the order of the contract.
        references: FMI value reference of each of `roles`.
        unstated: names of roles whose unit the FMU does not state; taken as the contract's.
        platforms: that it has binaries for, as FMI names them.
        model: what FMPy read.
    """

    path: Path
    sha256: str
    roles: tuple[Role, ...]
    references: tuple[int, ...]
    unstated: tuple[str, ...]
    platforms: tuple[str, ...]
    model: Any

    @property
    def parameters(self) -> dict[str, Any]:
        """The FMU's parameters by name, as FMPy's variables."""
        return {v.name: v for v in self.model.modelVariables if v.causality == "parameter"}

    def warnings(self) -> list[str]:
        """What FMPy's validation finds; validators disagree with each other, so nothing here refuses the FMU."""
        from fmpy.validation import validate_fmu

        return [" ".join(problem.split()) for problem in validate_fmu(str(self.path))]

    def checked_parameters(self, values: Mapping[str, float]) -> dict[int, float]:
        """Parameter `values` by value reference.

        Raises:
            InputRefused: an unknown name, a parameter that is not Real, a value outside min and max or not finite.
        """
        references: dict[int, float] = {}
        for name, value in values.items():
            known = self.parameters
            if name not in known:
                close = difflib.get_close_matches(name, list(known), 1)
                hint = f"did you mean '{close[0]}'?" if close else f"it has {', '.join(known) or 'none'}"
                raise InputRefused(f"{self.path}: no parameter '{name}'; {hint}")
            variable = known[name]
            if variable.type != "Real":
                raise InputRefused(f"{self.path}: parameter '{name}' is {variable.type}; only Real ones can be set")
            low = float(variable.min) if variable.min is not None else -math.inf
            high = float(variable.max) if variable.max is not None else math.inf
            if not (low <= value <= high and math.isfinite(value)):
                raise InputRefused(
                    f"{self.path}: parameter {name} = {value:g}: expected {low:g} .. {high:g} {variable.unit or ''}"
                )
            references[variable.valueReference] = float(value)
        return references


def resolved(path: Path) -> Path:
    """The .fmu file meant by `path`: itself, or `<folder>/<folder>.fmu` for a drive's folder.

    Raises:
        InputRefused: nothing there.
    """
    if path.is_dir():
        inside = path / f"{path.name}.fmu"
        if inside.is_file():
            return inside
        raise InputRefused(f"{path}: a folder without {inside.name}; name the .fmu file itself")
    if not path.is_file():
        raise InputRefused(f"{path}: no such drive; expected an .fmu file or a folder of fmus/")
    return path


def described(path: Path) -> DriveDescription:
    """Read and check the drive FMU at `path` (file or folder).

    Raises:
        InputRefused: not a zip, no readable model description, not FMI 2.0 co-simulation, no binary for this platform,
            a contract variable missing, of wrong causality, type or unit.
    """
    file = resolved(path)
    names = _entries(file)
    model = _model(file)
    version = model.fmiVersion
    if version != "2.0":
        raise InputRefused(f"{file}: FMI {version}; expected FMI 2.0 co-simulation, export it as that")
    if model.coSimulation is None:
        raise InputRefused(f"{file}: FMI 2.0 model exchange only; export it for co-simulation")
    if model.coSimulation.needsExecutionTool:
        raise InputRefused(f"{file}: needs its authoring tool while running; export it self-contained")
    binary = f"binaries/{platform}/{model.coSimulation.modelIdentifier}{sharedLibraryExtension}"
    platforms = sorted({PurePosixPath(n).parts[1] for n in names if n.startswith("binaries/") and n.count("/") > 1})
    if binary not in names:
        raise InputRefused(
            f"{file}: no binary for this platform ({binary}); it has {', '.join(platforms) or 'none'}. "
            f"Export it for {platform}, or build it from its sources"
        )
    filled = [(role, _variable(file, model, role)) for role in ROLES]
    present_roles = [(role, variable) for role, variable in filled if variable is not None]
    return DriveDescription(
        path=file,
        sha256=hashlib.sha256(file.read_bytes()).hexdigest(),
        roles=tuple(role for role, _ in present_roles),
        references=tuple(variable.valueReference for _, variable in present_roles),
        unstated=tuple(role.port.name for role, variable in present_roles if not _unit_name(variable)),
        platforms=tuple(platforms),
        model=model,
    )


def _entries(file: Path) -> set[str]:
    try:
        with zipfile.ZipFile(file) as archive:
            names = archive.namelist()
            for name in names:
                parts = PurePosixPath(name).parts
                if name.startswith("/") or ".." in parts or ":" in name or "\\" in name:
                    raise InputRefused(f"{file}: entry '{name}' points outside the archive; do not trust this file")
            damaged = archive.testzip()
            if damaged:
                raise InputRefused(f"{file}: entry '{damaged}' is damaged; get the FMU again")
            return set(names)
    except (zipfile.BadZipFile, zlib.error, EOFError, NotImplementedError) as problem:
        raise InputRefused(f"{file}: not a complete FMU, {str(problem).lower()}; an FMU is a zip archive") from None


def _model(file: Path) -> Any:
    try:
        return read_model_description(str(file), validate=False)
    except KeyError:
        raise InputRefused(f"{file}: no modelDescription.xml inside; this is not an FMU") from None
    # FMPy raises bare Exception and lxml its own family: whatever it says of this file is the reason
    except Exception as problem:
        raise InputRefused(f"{file}: modelDescription.xml cannot be read: {problem}") from None


def _unit_name(variable: Any) -> str | None:
    return variable.unit or (variable.declaredType.unit if variable.declaredType else None)


def _variable(file: Path, model: Any, role: Role) -> Any | None:
    """The FMU's variable for `role`, None if it may be missing and is."""
    name = role.port.name
    candidates = {v.name: v for v in model.modelVariables}
    if name not in candidates:
        if not role.required:
            return None
        offered = [v.name for v in model.modelVariables if v.causality == role.causality]
        raise InputRefused(
            f"{file}: no {role.causality} '{name}' ({role.port.meaning}, {role.port.unit}); "
            f"its {role.causality}s are {', '.join(offered) or 'none'}"
        )
    variable = candidates[name]
    if variable.causality != role.causality:
        raise InputRefused(
            f"{file}: '{name}' has causality {variable.causality}; the drive contract needs {role.causality}"
        )
    if variable.type != "Real":
        raise InputRefused(f"{file}: '{name}' has type {variable.type}; the drive contract needs Real")
    unit = _unit_name(variable)
    if unit and not _fits(model, unit, role.dimension):
        raise InputRefused(
            f"{file}: {role.causality} '{name}' has unit '{unit}'; the drive contract needs {role.port.unit}"
        )
    return variable


def _fits(model: Any, unit: str, dimension: Dimension) -> bool:
    """Whether the model's definition of `unit` is SI and of `dimension`."""
    for definition in model.unitDefinitions:
        if definition.name == unit and definition.baseUnit is not None:
            base = definition.baseUnit
            same = Dimension(*(getattr(base, field) for field in Dimension._fields)) == dimension
            return same and float(base.factor) == 1.0 and float(base.offset) == 0.0
    return unit.replace(".", " ") in {role.port.unit for role in ROLES if role.dimension == dimension}
