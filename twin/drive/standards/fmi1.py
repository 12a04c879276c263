"""FMI 1.0 for co-simulation: instantiated, initialised, ended (FMI 1.0 for Co-Simulation, 4.1)."""

import weakref
from contextlib import suppress
from ctypes import byref
from typing import TYPE_CHECKING

from fmpy import fmi1

from twin.drive.slave import FMU1Drive
from twin.drive.standards.fmi2 import guid_differs, type_name, values

if TYPE_CHECKING:
    from twin.drive.instance import Instance

__all__ = ["SLAVE", "enter", "free", "initialise", "instantiate", "leave", "type_name", "values", "why_refused"]

SLAVE = FMU1Drive

FUNCTIONS = {"Instantiate": "InstantiateSlave", "Initialize": "InitializeSlave", "Reset": "ResetSlave"}

_SPEAKERS: weakref.WeakValueDictionary[int, "Instance"] = weakref.WeakValueDictionary()
"""Instances by the address of the FMU's own; 0: the one that is being made."""


@fmi1.fmi1CallbackLoggerTYPE
def _logged(component: int | None, instance: bytes, status: int, category: bytes, message: bytes) -> None:
    """What an FMI 1.0 FMU says goes to its own instance; see `fmi2`."""
    # the one being made first: it may have got the address of one that is gone
    speaker = _SPEAKERS.get(0) or _SPEAKERS.get(component or 0)
    if speaker is not None:
        speaker.hear(status, message)


def instantiate(instance: "Instance") -> None:
    """Make the FMU's own instance; it is NULL if it refuses."""
    from fmpy.logging import addLoggerProxy

    callbacks = fmi1.fmi1CallbackFunctions()
    callbacks.logger = _logged
    callbacks.allocateMemory = fmi1.defaultCallbacks.allocateMemory
    callbacks.freeMemory = fmi1.defaultCallbacks.freeMemory
    addLoggerProxy(byref(callbacks))
    _SPEAKERS[0] = instance
    try:
        with instance.calling("InstantiateSlave"):
            instance.fmu.instantiate(functions=callbacks, loggingOn=False)
    finally:
        del _SPEAKERS[0]
    if instance.fmu.component:
        _SPEAKERS[instance.handle] = instance


def why_refused(instance: "Instance") -> str:
    """What may be the reason for a NULL instance."""
    return guid_differs(instance)


def initialise(instance: "Instance") -> None:
    """Bring it to where it can be stepped; it is told no tolerance, for which FMI 1.0 has no word."""
    enter(instance)
    leave(instance)


def enter(instance: "Instance") -> None:
    """Set what is set before it is initialised, of which FMI 1.0 makes no mode."""
    instance.write(instance.settings)
    instance.write(instance.inputs)


def leave(instance: "Instance") -> None:
    """Initialise it."""
    with instance.calling("InitializeSlave"):
        instance.fmu.initialize(tStart=0.0, stopTime=instance.setup.stop)


def free(instance: "Instance") -> None:
    """End it, free it and its library."""
    with instance.calling("TerminateSlave"), suppress(Exception):
        instance.fmu.terminate()
    with instance.calling("FreeSlaveInstance"):
        instance.fmu.freeInstance()
