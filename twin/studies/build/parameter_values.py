"""Units and values of the elements of an SSP, with the source of each value."""

from collections.abc import Iterable, Sequence

import numpy as np

from twin.kernel.fmi.description import FmuDescription
from twin.kernel.fmi.variable import Setting, Variable
from twin.kernel.ssp import structure as ssp
from twin.kernel.units import Dimension, known_unit
from twin.robot.experiment.experiment import Experiment

ConnectorUnit = tuple[ssp.Connector, ssp.UnitDefinition | None]
"""A connector and its unit."""
FROM_ROBOT = ("plant", "controller.model")
"""Tables whose missing keys are filled in from the robot's table."""
SSP_TYPES = {name: name for name in ("Real", "Boolean", "String", "Enumeration", "Binary")} | {
    "Float64": "Real", "Float32": "Real",
}  # fmt: skip
# some tools declare their outputs as local
FOREIGN_KINDS: dict[str, ssp.ConnectorKind] = {
    "input": "input", "output": "output", "local": "output", "parameter": "parameter",
    "structuralParameter": "parameter",
}  # fmt: skip


def unambiguous_units(units: Iterable[ssp.UnitDefinition | None]) -> dict[str, ssp.UnitDefinition]:
    """Collect the units of one SSP file by name, without names that have two meanings."""
    found: dict[str, ssp.UnitDefinition] = {}
    disputed: set[str] = set()
    for unit in units:
        if unit is not None and found.setdefault(unit.name, unit) != unit:
            disputed.add(unit.name)
    return {name: unit for name, unit in sorted(found.items()) if name not in disputed}


def origin(experiment: Experiment, key: str) -> str:
    """Return the source that the experiment states for a key's value; "" if not stated."""
    for table in FROM_ROBOT:
        if key.startswith(f"{table}.") and key not in experiment.origins:
            key = f"robot{key.removeprefix(table)}"
    return experiment.origins.get(key, "")


def foreign_connectors(description: FmuDescription, variables: Sequence[Variable]) -> tuple[ConnectorUnit, ...]:
    found = []
    for v in variables:
        kind, unit = _type(v), _unit(v, description)
        # the FMU itself declares the enumeration
        type_ = "" if kind == "Enumeration" else kind
        connector = ssp.Connector(
            v.name, FOREIGN_KINDS[v.causality], type_, unit.name if unit else "", (), v.description
        )
        found.append((connector, unit))
    return tuple(found)


def foreign_values(
    experiment: Experiment,
    name: str,
    table: str,
    description: FmuDescription,
    settings: Sequence[Setting],
    source: str,
    metadata: ssp.Metadata,
) -> ssp.ParameterSet:
    """Return the SSP parameter set of a drive's FMU, entry `source` of the archive: its values before initialisation.

    Args:
        table: table of the experiment with the FMU's parameters, "drive.parameters".
        settings: values in the FMU's own units.
    """
    facts = {variable.name: (_type(variable), _unit(variable, description)) for variable, _ in settings}
    units = unambiguous_units(unit for _, unit in facts.values())
    values = []
    for variable, value in settings:
        kind, unit = facts[variable.name]
        stated = origin(experiment, f"{table}.{variable.name}")
        if variable.causality == "input" and not stated:
            stated = "at the start of the experiment, the robot at rest"
        named = unit.name if unit is not None and unit.name in units else ""
        values.append(ssp.ParameterValue(variable.name, kind, (_plain(variable, kind, value),), named, stated))  # type: ignore[arg-type]
    return ssp.ParameterSet(name, tuple(values), tuple(units.values()), source, metadata)


def _plain(variable: Variable, kind: str, value: float | np.ndarray | list[str] | list[bytes]) -> float | str:
    """Convert an FMU value to its form in an SSP parameter set: text, bytes as hex, enumeration items by name."""
    one = value if isinstance(value, float) else value[0]
    if isinstance(one, bytes):
        return one.hex()
    if isinstance(one, str):
        return one
    return variable.format_value(float(one)) if kind == "Enumeration" else float(one)


def _type(variable: Variable) -> str:
    """Return the SSP 1.0 type of an FMU variable; all integers of FMI 3.0 are Integer."""
    return SSP_TYPES.get(variable.type, "Integer")


def _unit(variable: Variable, description: FmuDescription) -> ssp.UnitDefinition | None:
    text = variable.unit
    if not text or _type(variable) != "Real":
        return None
    for stated in description.model.unitDefinitions:
        if stated.name == text and stated.baseUnit is not None:
            base = stated.baseUnit
            powers = Dimension(*(int(getattr(base, name) or 0) for name in Dimension._fields))
            return ssp.UnitDefinition(text, powers, float(base.factor), float(base.offset))
    known = known_unit(text)
    return None if known is None else ssp.UnitDefinition(text, known.dimension, known.scale)
