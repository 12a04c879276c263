"""FMI 2.0 for co-simulation, from loading to step mode (FMI 2.0.4, 4.2)."""

import weakref
from ctypes import byref
from typing import TYPE_CHECKING, Any

from fmpy import fmi2

from twin.drive.slave import FMU2Drive
from twin.drive.variable import Variable

if TYPE_CHECKING:
    from twin.drive.instance import Instance

SLAVE = FMU2Drive

_SPEAKERS: weakref.WeakValueDictionary[int, "Instance"] = weakref.WeakValueDictionary()
"""Instances by the environment that their FMU hands back when it logs."""


@fmi2.fmi2CallbackLoggerTYPE
def _logged(environment: int | None, instance: bytes, status: int, category: bytes, message: bytes) -> None:
    """What an FMI 2 FMU says goes to its own instance.

    FMPy's proxy calls the logger that it was given last, whichever FMU speaks: it has to be one that serves them all
    and that outlives each of them.
    """
    speaker = _SPEAKERS.get(environment or 0)
    if speaker is not None:
        speaker.hear(status, message)


def instantiate(instance: "Instance") -> None:
    """Make the FMU's own instance; it is NULL if it refuses."""
    from fmpy.logging import addLoggerProxy

    callbacks = fmi2.fmi2CallbackFunctions()
    callbacks.logger = _logged
    callbacks.componentEnvironment = id(instance)
    _SPEAKERS[id(instance)] = instance
    callbacks.allocateMemory = fmi2.defaultCallbacks.allocateMemory
    callbacks.freeMemory = fmi2.defaultCallbacks.freeMemory
    addLoggerProxy(byref(callbacks))
    with instance.calling("Instantiate"):
        instance.fmu.instantiate(callbacks=callbacks, loggingOn=False)


def why_refused(instance: "Instance") -> str:
    """What may be the reason for a NULL instance."""
    return guid_differs(instance)


def guid_differs(instance: "Instance") -> str:
    """The commonest reason."""
    guid = instance.description.model.guid
    return f"the GUID {guid} in modelDescription.xml may not be the binary's own: export it again"


def initialise(instance: "Instance") -> None:
    """Bring it into step mode."""
    enter(instance)
    leave(instance)


def enter(instance: "Instance") -> None:
    """Bring it into initialisation mode."""
    instance.write(instance.settings)
    with instance.calling("SetupExperiment"):
        instance.fmu.setupExperiment(tolerance=instance.setup.tolerance, startTime=0.0, stopTime=instance.setup.stop)
    with instance.calling("EnterInitializationMode"):
        instance.fmu.enterInitializationMode()
    instance.write(instance.inputs)


def leave(instance: "Instance") -> None:
    """Bring it from there into step mode."""
    with instance.calling("ExitInitializationMode"):
        instance.fmu.exitInitializationMode()


def type_name(variable: Variable) -> str:
    """What the functions that set and get this variable are called after."""
    return "Integer" if variable.type == "Enumeration" else variable.type


def values(fmu: Any, variable: Variable) -> Any:
    """Of a variable, in its own unit."""
    return getattr(fmu, f"get{type_name(variable)}")([variable.reference])


def free(instance: "Instance") -> None:
    """Free it and its library."""
    with instance.calling("FreeInstance"):
        instance.fmu.freeInstance()
