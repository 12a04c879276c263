"""Values of an experiment as parameter sets (SSV): with units, and where each value comes from."""

import re
from collections.abc import Iterable, Sequence
from typing import NamedTuple

import numpy as np

from twin.drive.description import FmuDescription
from twin.drive.setting import Setting
from twin.drive.variable import Variable
from twin.experiment.experiment import Experiment
from twin.ssp.metadata import Metadata
from twin.ssp.parameters import ParameterSet, ParameterValue
from twin.ssp.unit import UnitDefinition
from twin.studies.build.layout import Variable as OwnVariable
from twin.units import Dimension, known_unit

FROM_ROBOT = ("plant", "controller.model")
"""Tables that the robot's own fills where they say nothing."""
TYPES = {name: name for name in ("Real", "Boolean", "String", "Enumeration", "Binary")}
TYPES |= {"Float64": "Real", "Float32": "Real"}


class Measured(NamedTuple):
    """In what a variable is.

    Attributes:
        type: as SSP 1.0 calls it.
        unit: None: nobody says what it is.
    """

    type: str
    unit: UnitDefinition | None


def measured(variable: Variable, description: FmuDescription) -> Measured:
    """Of a variable of an FMU; a whole number of FMI 3.0 is an Integer."""
    kind = TYPES.get(variable.type, "Integer")
    return Measured(kind, _definition(variable.unit, description) if kind == "Real" and variable.unit else None)


def measured_here(variable: OwnVariable) -> Measured:
    """Of a variable of ours."""
    return Measured("Real", UnitDefinition(variable.text, variable.unit.dimension, variable.unit.scale))


def _definition(text: str, description: FmuDescription) -> UnitDefinition | None:
    for stated in description.model.unitDefinitions:
        if stated.name == text and stated.baseUnit is not None:
            base = stated.baseUnit
            powers = Dimension(*(int(getattr(base, name) or 0) for name in Dimension._fields))
            return UnitDefinition(text, powers, float(base.factor), float(base.offset))
    known = known_unit(text)
    return None if known is None else UnitDefinition(text, known.dimension, known.scale)


def defined(units: Iterable[UnitDefinition | None]) -> dict[str, UnitDefinition]:
    """Units of one file by their names; where two mean different things by one name, it is nobody's."""
    found: dict[str, UnitDefinition] = {}
    disputed: set[str] = set()
    for unit in units:
        if unit is not None and found.setdefault(unit.name, unit) != unit:
            disputed.add(unit.name)
    return {name: unit for name, unit in sorted(found.items()) if name not in disputed}


def own_values(
    experiment: Experiment, name: str, variables: Sequence[OwnVariable], source: str, metadata: Metadata
) -> ParameterSet:
    """The parameters of a part of ours, each with where it comes from.

    Args:
        experiment: whose values they are.
        name: of the part.
        variables: scalars.
        source: entry of the archive.
        metadata: of the file.
    """
    given = [v for v in variables if v.kind in ("parameter", "tunable")]
    values = [
        ParameterValue(v.name, "Real", v.start, v.text, origin(experiment, re.sub(r"\[\d+\]$", "", v.name)))
        for v in given
    ]
    units = defined(measured_here(v).unit for v in given)
    return ParameterSet(name, tuple(values), tuple(units.values()), source, metadata)


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
    facts = {variable.name: measured(variable, description) for variable, _ in settings}
    units = defined(fact.unit for fact in facts.values())
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


def origin(experiment: Experiment, key: str) -> str:
    """Where the value of a key of the experiment's file comes from; "" if nobody says."""
    for table in FROM_ROBOT:
        if key.startswith(f"{table}.") and key not in experiment.origins:
            key = f"robot{key.removeprefix(table)}"
    return experiment.origins.get(key, "")
