"""Connectors and values of an FMU of ours, in an SSP."""

import re
from collections.abc import Sequence

from twin.kernel.ssp.parameters import Metadata, ParameterSet, ParameterValue, UnitDefinition
from twin.kernel.ssp.structure import Connector, ConnectorKind
from twin.robot.experiment.experiment import Experiment
from twin.studies.build.layout import Kind, Variable
from twin.studies.build.structure import Told, defined, origin

KINDS: dict[Kind, ConnectorKind] = {
    "parameter": "parameter", "tunable": "parameter", "input": "input", "output": "output",
}  # fmt: skip


def own_connectors(variables: Sequence[Variable]) -> tuple[Told, ...]:
    """One for each of its scalars."""
    return tuple((Connector(v.name, KINDS[v.kind], "Real", v.text, (), v.meaning), _unit(v)) for v in variables)


def own_values(
    experiment: Experiment, name: str, variables: Sequence[Variable], source: str, metadata: Metadata
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
    units = defined(_unit(v) for v in given)
    return ParameterSet(name, tuple(values), tuple(units.values()), source, metadata)


def _unit(variable: Variable) -> UnitDefinition:
    return UnitDefinition(variable.text, variable.unit.dimension, variable.unit.scale)
