"""Connectors and values of an FMU of another make, in an SSP."""

from collections.abc import Sequence

import numpy as np

from twin.kernel.fmi.description import FmuDescription
from twin.kernel.fmi.setting import Setting
from twin.kernel.fmi.variable import Variable
from twin.kernel.ssp.parameters import Metadata, ParameterSet, ParameterValue, UnitDefinition
from twin.kernel.ssp.structure import Connector, ConnectorKind
from twin.kernel.units import Dimension, known_unit
from twin.robot.experiment.experiment import Experiment
from twin.studies.build.structure import Told, defined, origin

TYPES = {name: name for name in ("Real", "Boolean", "String", "Enumeration", "Binary")}
TYPES |= {"Float64": "Real", "Float32": "Real"}

# some tools leave their outputs marked as local
THEIRS: dict[str, ConnectorKind] = {
    "input": "input", "output": "output", "local": "output", "parameter": "parameter",
    "structuralParameter": "parameter",
}  # fmt: skip


def foreign_connectors(description: FmuDescription, variables: Sequence[Variable]) -> tuple[Told, ...]:
    """Of an FMU of another make, for some of its variables."""
    found = []
    for v in variables:
        kind, unit = _type(v), _unit(v, description)
        # which enumeration, the FMU tells
        type_ = "" if kind == "Enumeration" else kind
        connector = Connector(v.name, THEIRS[v.causality], type_, unit.name if unit else "", (), v.description)
        found.append((connector, unit))
    return tuple(found)


def foreign_values(
    experiment: Experiment,
    name: str,
    table: str,
    description: FmuDescription,
    settings: Sequence[Setting],
    source: str,
    metadata: Metadata,
) -> ParameterSet:
    """What an FMU of a drive is set to before it is initialised.

    Args:
        experiment: whose values they are.
        name: of the element.
        table: of the experiment that says its parameters, "drive.parameters".
        description: of the FMU.
        settings: in its own units.
        source: entry of the archive.
        metadata: of the file.
    """
    facts = {variable.name: (_type(variable), _unit(variable, description)) for variable, _ in settings}
    units = defined(unit for _, unit in facts.values())
    values = []
    for variable, value in settings:
        kind, unit = facts[variable.name]
        said = origin(experiment, f"{table}.{variable.name}")
        if variable.causality == "input" and not said:
            said = "at the start of the experiment, the robot at rest"
        named = unit.name if unit is not None and unit.name in units else ""
        values.append(ParameterValue(variable.name, kind, (_plain(variable, kind, value),), named, said))  # type: ignore[arg-type]
    return ParameterSet(name, tuple(values), tuple(units.values()), source, metadata)


def _plain(variable: Variable, kind: str, value: float | np.ndarray | list[str] | list[bytes]) -> float | str:
    """A value as a parameter set has it: texts, bytes in hexadecimal, items by their names."""
    one = value if isinstance(value, float) else value[0]
    if isinstance(one, bytes):
        return one.hex()
    if isinstance(one, str):
        return one
    return variable.told(float(one)) if kind == "Enumeration" else float(one)


def _type(variable: Variable) -> str:
    """As SSP 1.0 calls it; a whole number of FMI 3.0 is an Integer."""
    return TYPES.get(variable.type, "Integer")


def _unit(variable: Variable, description: FmuDescription) -> UnitDefinition | None:
    """What its values are in; None: nobody says."""
    text = variable.unit
    if not text or _type(variable) != "Real":
        return None
    for stated in description.model.unitDefinitions:
        if stated.name == text and stated.baseUnit is not None:
            base = stated.baseUnit
            powers = Dimension(*(int(getattr(base, name) or 0) for name in Dimension._fields))
            return UnitDefinition(text, powers, float(base.factor), float(base.offset))
    known = known_unit(text)
    return None if known is None else UnitDefinition(text, known.dimension, known.scale)
