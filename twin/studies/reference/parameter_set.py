"""Parameter files (SSV) as an FMU takes them."""

from twin.cosim.ssp.parameters import ParameterSet
from twin.drive.description import FmuDescription
from twin.drive.setting import Value, taken
from twin.errors import InputRefused, nearest


def settings(values: ParameterSet, description: FmuDescription, where: str) -> dict[str, Value]:
    """`values` in the units of the FMU.

    Raises:
        InputRefused: a parameter the FMU has not, or cannot take, or in a unit that is not one of the same quantity.
    """
    set_: dict[str, Value] = {}
    for value in values.parameters:
        variable = description.variables.get(value.name)
        if variable is None:
            hint = nearest(value.name, description.variables, "it has no name like it")
            raise InputRefused(f"{where}: no parameter '{value.name}' in {description.path.name}; {hint}")
        set_[value.name] = taken(value, variable, description, values.units, where)
    try:
        description.settings(set_)
    except InputRefused as refusal:
        raise InputRefused(f"{where}: {str(refusal).removeprefix(f'{description.path}: ')}") from None
    return set_
