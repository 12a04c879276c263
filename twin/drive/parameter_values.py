"""Values of a parameter set (SSV) as an FMU takes them: in its own units."""

from collections.abc import Sequence

from twin.drive.description import FmuDescription
from twin.drive.setting import Value
from twin.drive.units import Conversion, conversion, meant
from twin.drive.variable import Variable
from twin.errors import InputRefused
from twin.ssp.parameters import ParameterValue
from twin.ssp.unit import UnitDefinition


def taken(
    value: ParameterValue,
    variable: Variable,
    description: FmuDescription,
    units: Sequence[UnitDefinition],
    where: str,
    suppressed: bool = False,
) -> Value:
    """A value for a variable.

    Args:
        value: as the set has it.
        variable: that takes it.
        description: of its FMU.
        units: that the set defines; what it does not define may be one of the FMU's, or known to all.
        where: for sentences.
        suppressed: whether its unit is passed over.

    Raises:
        InputRefused: its unit is not one of the same quantity, or it is binary.
    """
    if value.type == "Binary":
        raise InputRefused(f"{where}: {value.name} is binary, which is not read here")
    unit, numbers = value.unit, [v for v in value.values if isinstance(v, float)]
    if numbers and unit and unit != variable.unit and not suppressed:
        stated, own = (
            stated_unit(unit, units) or conversion(unit, description.model.unitDefinitions),
            variable.conversion,
        )
        if stated is None or own is None or stated.dimension != own.dimension:
            wanted = f"'{variable.unit or '1'}', as in the FMU, or a unit like it"
            raise InputRefused(f"{where}: {value.name} in '{unit}'; expected {wanted}")
        numbers = [(stated.factor * number + stated.offset - own.offset) / own.factor for number in numbers]
    given: Sequence[float] | Sequence[str] = numbers or [str(v) for v in value.values]
    return given[0] if len(given) == 1 else given


def stated_unit(unit: str, definitions: Sequence[UnitDefinition]) -> Conversion | None:
    """How values in `unit` become SI by the `definitions` of an SSP file; None: it does not define that unit."""
    for one in definitions:
        if one.name == unit:
            return meant(unit, Conversion(one.dimension, one.factor, one.offset))
    return None
