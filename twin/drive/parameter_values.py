"""Values of a parameter set (SSV) as an FMU takes them: in its own units."""

from collections.abc import Sequence

from twin.cosim.ssp.parameters import ParameterValue
from twin.cosim.ssp.unit import UnitDefinition
from twin.drive.description import FmuDescription
from twin.drive.setting import FILE, Value
from twin.drive.units import Conversion, conversion, meant
from twin.drive.variable import Variable
from twin.errors import InputRefused


def taken(
    value: ParameterValue,
    variable: Variable,
    description: FmuDescription,
    units: Sequence[UnitDefinition],
    where: str,
) -> Value:
    """A value for a variable.

    Args:
        value: as the set has it.
        variable: that takes it.
        description: of its FMU.
        units: that the set defines; what it does not define may be one of the FMU's, or known to all.
        where: for sentences.

    Raises:
        InputRefused: its unit is not one of the same quantity, or it is binary.
    """
    values = given_values(value, where)
    unit = value.unit
    if unit and unit != variable.unit and not isinstance(values[0], str):
        stated, own = (
            stated_unit(unit, units) or conversion(unit, description.model.unitDefinitions),
            variable.conversion,
        )
        if stated is None or own is None or stated.dimension != own.dimension:
            wanted = f"'{variable.unit or '1'}', as in the FMU, or a unit like it"
            raise InputRefused(f"{where}: {value.name} in '{unit}'; expected {wanted}")
        values = [(stated.factor * float(number) + stated.offset - own.offset) / own.factor for number in values]
    return values[0] if len(values) == 1 else values


def given_values(value: ParameterValue, where: str) -> list[float] | list[str]:
    """What a parameter set gives, at least one value.

    Raises:
        InputRefused: it is binary, nothing, or text that names a file of this machine where an experiment says it.
    """
    if value.type == "Binary" or not value.values:
        what = "binary, which is not read here" if value.values else "given no value"
        raise InputRefused(f"{where}: {value.name} is {what}")
    if any(isinstance(one, str) and one.startswith(FILE) for one in value.values):
        raise InputRefused(
            f"{where}: {value.name} begins with '{FILE}'; a parameter set may not name files of this machine"
        )
    return list(value.values)  # type: ignore[return-value]


def stated_unit(unit: str, definitions: Sequence[UnitDefinition]) -> Conversion | None:
    """How values in `unit` become SI by the `definitions` of an SSP file; None: it does not define that unit."""
    for one in definitions:
        if one.name == unit:
            return meant(unit, Conversion(one.dimension, one.factor, one.offset))
    return None
