"""FMI 3.0 for co-simulation, from loading to step mode (FMI 3.0.2, 2.3 and 4.2)."""

import os
from collections.abc import Sequence
from typing import TYPE_CHECKING, Any

import numpy as np
from fmpy import fmi3

from twin.drive.clocks import clock_table
from twin.drive.description import STRUCTURAL
from twin.drive.events import EVENTS, settle
from twin.drive.kinds import KINDS
from twin.drive.ramp import intermediate_update
from twin.drive.setting import Setting
from twin.drive.slave import FMU3Drive
from twin.drive.standards.fmi2 import free, guid_differs
from twin.drive.status import told
from twin.drive.variable import Variable
from twin.errors import InputRefused

if TYPE_CHECKING:
    from twin.drive.instance import Instance

__all__ = ["SLAVE", "enter", "free", "initialise", "instantiate", "leave", "type_name", "values", "why_refused"]

SLAVE = FMU3Drive
MOST_RETURNED = 40
"""Bytes of what functions of event mode return."""


def instantiate(instance: "Instance") -> None:
    """Make the FMU's own instance; it is NULL if it refuses.

    Event mode is used, and early return allowed, where the FMU has them.
    """
    fmu, abilities = instance.fmu, instance.description.model.coSimulation
    # ctypes frees what is not kept
    fmu.logMessage = fmi3.fmi3LogMessageCallback(
        lambda environment, status, category, said: instance.hear(status, said)
    )
    ramped = [v.reference for v in instance.description.variables.values() if instance.ramps(v)]
    fmu.intermediateUpdate = fmi3.fmi3IntermediateUpdateCallback(*([intermediate_update.address] if ramped else []))
    with instance.calling("InstantiateCoSimulation"):
        fmu.component = fmu.fmi3InstantiateCoSimulation(
            instance.name.encode(),
            fmu.guid.encode(),
            (os.path.join(fmu.unzipDirectory, "resources") + os.path.sep).encode(),
            False,
            False,
            abilities.hasEventMode,
            instance.description.returns_early,
            (fmi3.fmi3ValueReference * len(ramped))(*ramped),
            len(ramped),
            instance.ramp.ctypes.data,
            fmu.logMessage,
            fmu.intermediateUpdate,
        )


def why_refused(instance: "Instance") -> str:
    """What may be the reason for a NULL instance."""
    clocks = [v.name for v in instance.description.variables.values() if v.type == "Clock"]
    if clocks and not instance.description.model.coSimulation.hasEventMode:
        return f"it has clocks ({', '.join(clocks[:3])}), and states no event mode (hasEventMode): export it again"
    return guid_differs(instance)


def initialise(instance: "Instance") -> None:
    """Bring it into step mode, by way of configuration mode and event mode if it has them."""
    enter(instance)
    leave(instance)


def enter(instance: "Instance") -> None:
    """Bring it into initialisation mode, by way of configuration mode."""
    fmu = instance.fmu
    structure = [setting for setting in instance.settings if setting[0].causality == STRUCTURAL]
    if structure:
        with instance.calling("EnterConfigurationMode"):
            fmu.enterConfigurationMode()
        instance.write(structure)
        with instance.calling("ExitConfigurationMode"):
            fmu.exitConfigurationMode()
    instance.write([setting for setting in instance.settings if setting[0].causality != STRUCTURAL])
    with instance.calling("EnterInitializationMode"):
        fmu.enterInitializationMode(tolerance=instance.setup.tolerance, startTime=0.0, stopTime=instance.setup.stop)
    instance.write(_unclocked(instance.inputs))


def leave(instance: "Instance") -> None:
    """Bring it from there into step mode, by way of event mode if it has that."""
    events = getattr(instance.description.interface, "hasEventMode", False)
    if events:
        with instance.calling("GetIntervalDecimal"):
            instance.clocks = clock_table(instance)
    with instance.calling("ExitInitializationMode"):
        instance.fmu.exitInitializationMode()
    if events:
        _leave_event_mode(instance)


def _unclocked(inputs: Sequence[Setting]) -> list[Setting]:
    """Those that may be set although no clock ticks."""
    return [setting for setting in inputs if not setting[0].clocks]


def _leave_event_mode(instance: "Instance") -> None:
    """From event mode, into which initialisation leads, to step mode; what steps need of events is kept."""
    instance.planned = np.array([np.inf])
    instance.returned = np.zeros(MOST_RETURNED, dtype=np.uint8)
    instance.events = np.zeros(1, dtype=EVENTS)
    e = instance.events[0]
    e["instance"], e["step"] = instance.handle, instance.setup.step or 1.0
    e["enter_event_mode"], e["enter_step_mode"] = (instance.address(f"Enter{mode}Mode") for mode in ("Event", "Step"))
    e["update"], e["get_interval"] = instance.address("UpdateDiscreteStates"), instance.address("GetIntervalDecimal")
    e["set_clock"], e["get_clock"] = instance.address("SetClock"), instance.address("GetClock")
    e["clocks"], e["clock_table"] = len(instance.clocks), instance.clocks.ctypes.data
    e["next"], e["returned"] = instance.planned.ctypes.data, instance.returned.ctypes.data
    # compiled before the call is announced: the FMU is not to be charged with it
    settled = settle.native.called
    with instance.calling("UpdateDiscreteStates"):
        status = settled(instance.events.ctypes.data, 0, -1, 0.0)
    if status != 0:
        raise InputRefused(told(status, "fmi3", {}, float(e["value"]), instance.clock_name(int(e["culprit"])), ""))
    with instance.calling("EnterStepMode"):
        instance.fmu.enterStepMode()


def type_name(variable: Variable) -> str:
    """What the functions that set and get this variable are called after."""
    return KINDS[variable.kind] if variable.kind >= 0 else variable.type


def values(fmu: Any, variable: Variable) -> Any:
    """Of a variable, in its own unit, an array laid out flat."""
    return getattr(fmu, f"get{type_name(variable)}")([variable.reference], nValues=variable.size)
