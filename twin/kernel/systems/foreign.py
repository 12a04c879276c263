"""Packages from files of other masters, which step all FMUs at once and convert no units (Jacobi)."""

from collections.abc import Mapping, Sequence
from dataclasses import replace
from pathlib import Path

from twin.kernel.ssp.package import Package, loose_package
from twin.kernel.ssp.structure import ParameterBinding, ParameterSet, ParameterValue, SspComponent, SspSystem, Structure
from twin.kernel.systems.naming import unique_names


def foreign_package(
    file: Path,
    form: str,
    structure: Structure,
    fmus: Mapping[str, Path],
    values: Mapping[str, Sequence[ParameterValue]],
    unsaid: Sequence[str],
) -> Package:
    """Make a package of a system file in another master's format (not SSP), with ignored statements `unsaid`.

    Components of `structure` have neither sources nor values; these are `fmus` and `values`, by component.
    """
    paths = [*dict.fromkeys(fmus.values())]
    entries = dict(zip(paths, unique_names(f"resources/{path.name}" for path in paths), strict=True))
    parts = [
        replace(one, source=entries[fmus[one.name]], bindings=_bindings(f"{one.name} values", values.get(one.name, ())))
        for one in structure.system.elements
        if isinstance(one, SspComponent)
    ]
    # these masters convert no units
    wires = tuple(replace(one, suppress_unit_conversion=True) for one in structure.system.connections)
    system = SspSystem(structure.name, tuple(parts), wires)
    loose = {entry: path for path, entry in entries.items()}
    return loose_package(file, replace(structure, system=system), loose, form, "jacobi", tuple(unsaid))


def _bindings(name: str, values: Sequence[ParameterValue]) -> tuple[ParameterBinding, ...]:
    return (ParameterBinding(ParameterSet(name, tuple(values))),) if values else ()
