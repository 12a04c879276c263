"""FMI 3.0 for co-simulation, from loading to step mode (FMI 3.0.2, 2.3 and 4.2)."""

from typing import TYPE_CHECKING, Any

from twin.drive.adapter import KINDS
from twin.drive.slave import FMU3Drive
from twin.drive.standards.fmi2 import free, guid_differs
from twin.drive.variable import Variable

if TYPE_CHECKING:
    from twin.drive.instance import Instance

__all__ = ["SLAVE", "free", "initialise", "instantiate", "type_name", "values", "why_refused"]

SLAVE = FMU3Drive


def instantiate(instance: "Instance") -> None:
    """Make the FMU's own instance; it is NULL if it refuses."""
    with instance.calling("Instantiate"):
        instance.fmu.instantiate(
            logMessage=lambda environment, status, category, said: instance.hear(status, said), loggingOn=False
        )


def why_refused(instance: "Instance") -> str:
    """What may be the reason for a NULL instance."""
    clocks = [v.name for v in instance.description.variables.values() if v.type == "Clock"]
    if clocks:
        return f"it may want its clocks ({', '.join(clocks[:3])}) served in event mode, which twin does not do"
    return guid_differs(instance)


def initialise(instance: "Instance") -> None:
    """Bring it into step mode."""
    instance.write(instance.settings)
    with instance.calling("EnterInitializationMode"):
        instance.fmu.enterInitializationMode(
            tolerance=instance.setup.tolerance, startTime=0.0, stopTime=instance.setup.stop
        )
    instance.write(instance.inputs)
    with instance.calling("ExitInitializationMode"):
        instance.fmu.exitInitializationMode()


def type_name(variable: Variable) -> str:
    """What the functions that set and get this variable are called after."""
    return KINDS[variable.kind]


def values(fmu: Any, variable: Variable) -> Any:
    """Of a variable, in its own unit, an array laid out flat."""
    return getattr(fmu, f"get{type_name(variable)}")([variable.reference], nValues=variable.size)
