"""The life cycle of an FMU per FMI version: load, instantiate, initialise, step mode.

FMI 1.0 for Co-Simulation, 4.1; FMI 2.0.4, 4.2; FMI 3.0.2, 2.3 and 4.2. FMPy's instances are loaded quickly: what they
find out about their functions is the same for every one of a kind. Clocks that we have to tick (FMI 3.0, 2.2.8) do so
in whole steps of the drive.
"""

import math
import os
import weakref
from collections.abc import Mapping
from contextlib import suppress
from ctypes import CFUNCTYPE, byref, c_char_p, c_double, c_int, c_uint
from typing import Any, ClassVar
from weakref import proxy

import numpy as np
from fmpy import fmi1, fmi2, fmi3
from fmpy.fmi1 import FMU1Slave
from fmpy.fmi2 import FMU2Model, FMU2Slave
from fmpy.fmi3 import FMU3Model, FMU3Slave

from twin.kernel.cosim.python_class import STEP_FUNCTION
from twin.kernel.errors import ComponentFailed, InputRefused
from twin.kernel.fmi.cosim_step import (
    CHANGING_CLOCK,
    CLOCK_RECORD,
    COUNTDOWN_CLOCK,
    EVENTS_RECORD,
    OUTPUT_CLOCK,
    PERIODIC_CLOCK,
    UNKNOWN_STEP,
    update_discrete_states,
)
from twin.kernel.fmi.description import STRUCTURAL_PARAMETER, clocks, stated_interval
from twin.kernel.fmi.groups import STATUS_WIDTH, explain_status, intermediate_update, status_phrase
from twin.kernel.fmi.instance import Instance
from twin.kernel.fmi.stepping import Stepping
from twin.kernel.fmi.variable import NUMERIC_TYPES, Variable

MAX_RETURNED_SIZE = 40
"""Bytes of what functions of event mode return."""

ERROR_STATUS = 3
"""fmi2Error, and what the others call so."""

NOT_YET_KNOWN = 0
"""fmi3IntervalNotYetKnown."""

_complete: set[str] = set()
"""Binaries, by their places, of which it is known that they have every function."""
_NEVER_CALLED = CFUNCTYPE(c_int)
_OTHER_KIND_FUNCTIONS = {
    "fmi3ActivateModelPartition",
    "fmi3DoStep",
    "fmi3EnterStepMode",
    "fmi3GetOutputDerivatives",
    "fmi3InstantiateCoSimulation",
    "fmi3InstantiateScheduledExecution",
}


class _LazyFunctions(dict[str, Any]):
    """Functions of `slave` by their names, found when they are asked for: a run calls a third of them."""

    def __init__(self, slave: "_SignatureCache"):
        super().__init__()
        # the slave holds this
        self._slave = proxy(slave)

    def __missing__(self, name: str) -> Any:
        self[name] = found = self._slave._function(name)
        return found


class _LenientLibrary:
    """A library whose missing functions are there and return an error, if they are ever called.

    Args:
        library: of ctypes.
        missing: to which their names are added.
    """

    def __init__(self, library: Any, missing: list[str]):
        self._library, self._missing = library, missing

    def __getattr__(self, name: str) -> Any:
        try:
            found = getattr(self._library, name)
        except AttributeError:
            if name.startswith("_"):
                raise
            self._missing.append(name)
            found = _NEVER_CALLED(lambda: ERROR_STATUS)
        vars(self)[name] = found
        return found


_forgiven: list[list[str]] = []
"""To whose last names of functions are added that the binary which is being loaded does not have; empty: it has to."""


class CallFailure(Exception):
    """A function of an FMU returned more than a warning."""


class _SignatureCache:
    """Gives the functions of a binary the signatures that FMPy has worked out for the first one of this process.

    FMPy reads them from its own methods with `inspect`, a few milliseconds for each instance. The binary itself is
    loaded and let go for each, as ever: what it keeps in static memory must not reach from one run into the next.
    """

    _signatures: ClassVar[dict[str, tuple[Any, ...]]]
    _functions: dict[str, Any]
    dll: Any

    def __init_subclass__(cls) -> None:
        cls._signatures = {}

    def _loadFunctions(self) -> None:
        known = type(self)._signatures
        if _forgiven:
            self.dll = _LenientLibrary(self.dll, _forgiven[-1])
        if not known:
            super()._loadFunctions()  # type: ignore[misc]
            known.update({name: self._signature(name, f) for name, f in self._functions.items()})
        elif self.dll._name not in _complete:
            for name in known:
                self._functions[name] = self._function(name)
        else:
            self._functions = _LazyFunctions(self)
        if not _forgiven:
            _complete.add(self.dll._name)

    def _call(self, name: str, *arguments: Any) -> Any:
        # FMPy takes negative integers for fmi2OK, and has no log of calls here
        function = self._functions[name]
        status = function(*arguments)
        if function.restype is c_int and status not in (0, 1):
            raise CallFailure(status_phrase(name.replace("fmi1", "fmi"), status))
        return status

    def _function(self, name: str) -> Any:
        """The function `name` of FMPy's, with its signature."""
        function = getattr(self.dll, self._exported_name(name))
        function.argnames, function.argtypes, function.restype = type(self)._signatures[name]
        return function

    def _exported_name(self, name: str) -> str:
        """What the binary calls the function `name` of FMPy's."""
        return name

    def _signature(self, name: str, function: Any) -> tuple[Any, ...]:
        return function.argnames, function.argtypes, function.restype


# FMPy tells the standard by how the class is called
class FMU1Drive(_SignatureCache, FMU1Slave):
    """An FMI 1.0 slave, whose functions have the model's name before theirs."""

    def _exported_name(self, name: str) -> str:
        return f"{self.modelIdentifier}_{name.replace('fmi1', 'fmi')}"

    def _signature(self, name: str, function: Any) -> tuple[Any, ...]:
        # FMPy has several return text that return a status: read as an address, every bad one would crash
        if not name.endswith(("Version", "TypesPlatform")) and function.restype is c_char_p:
            function.restype = c_int
        return super()._signature(name, function)


class FMU2Drive(_SignatureCache, FMU2Slave):
    """An FMI 2.0 slave."""


class FMU3Drive(_SignatureCache, FMU3Slave):
    """An FMI 3.0 slave."""


class FMU2Exchange(_SignatureCache, FMU2Model):
    """An FMI 2.0 model."""


class FMU3Exchange(_SignatureCache, FMU3Model):
    """An FMI 3.0 model."""

    def __dir__(self) -> list[str]:
        # FMPy looks here for the functions that a binary has to have, and these it need not have (FMI 3.0, 2.1.2)
        return [name for name in super().__dir__() if name not in _OTHER_KIND_FUNCTIONS]


_instances_1: weakref.WeakValueDictionary[int, Instance] = weakref.WeakValueDictionary()
"""Instances by the address of the FMU's own; 0: the one that is being made."""

_instances_2: weakref.WeakValueDictionary[int, Instance] = weakref.WeakValueDictionary()
"""Instances by the environment that their FMU hands back when it logs."""


@fmi1.fmi1CallbackLoggerTYPE
def _on_message_1(component: int | None, instance: bytes, status: int, category: bytes, message: bytes) -> None:
    """What an FMI 1.0 FMU says goes to its own instance; see `_on_message_2`."""
    # the one being made first: it may have got the address of one that is gone
    speaker = _instances_1.get(0) or _instances_1.get(component or 0)
    if speaker is not None:
        speaker.on_message(status, message)


@fmi2.fmi2CallbackLoggerTYPE
def _on_message_2(environment: int | None, instance: bytes, status: int, category: bytes, message: bytes) -> None:
    """What an FMI 2 FMU says goes to its own instance.

    FMPy's proxy calls the logger that it was given last, whichever FMU speaks: it has to be one that serves them all
    and that outlives each of them.
    """
    speaker = _instances_2.get(environment or 0)
    if speaker is not None:
        speaker.on_message(status, message)


class Fmi2:
    """How FMI 2.0 is spoken.

    Args:
        slave: class of FMPy's instances.
    """

    def __init__(self, slave: type = FMU2Drive):
        self.slave = slave

    def load_binary(self, instance: Instance) -> Any:
        """FMPy's instance with the binary; what that lacks is noted if it is forgiven."""
        description = instance.description
        if instance.setup.lenient:
            _forgiven.append(instance.missing)
        try:
            return self.slave(
                guid=description.model.guid,
                unzipDirectory=str(instance.folder),
                modelIdentifier=description.identifier,
                instanceName=instance.name,
            )
        finally:
            if instance.setup.lenient:
                _forgiven.pop()

    def instantiate(self, instance: Instance) -> None:
        """Make the FMU's own instance; it is NULL if it refuses."""
        callbacks = self._callbacks(fmi2, "fmi2CallbackFunctions", _on_message_2)
        callbacks.componentEnvironment = id(instance)
        _instances_2[id(instance)] = instance
        with instance.calling("Instantiate"):
            instance.fmu.instantiate(callbacks=callbacks, loggingOn=False)

    def refusal_reason(self, instance: Instance) -> str:
        """What may be the reason for a NULL instance."""
        guid = instance.description.model.guid
        return f"the GUID {guid} in modelDescription.xml may not be the binary's own: export it again"

    def initialise(self, instance: Instance) -> None:
        """Bring it to where it can be stepped."""
        self.enter(instance)
        self.leave(instance)

    def enter(self, instance: Instance) -> None:
        """Bring it into initialisation mode."""
        instance.write(instance.settings)
        with instance.calling("SetupExperiment"):
            instance.fmu.setupExperiment(
                tolerance=instance.setup.tolerance, startTime=instance.setup.start, stopTime=instance.setup.stop
            )
        with instance.calling("EnterInitializationMode"):
            instance.fmu.enterInitializationMode()
        instance.write(instance.inputs)

    def leave(self, instance: Instance) -> None:
        """Bring it from there into step mode."""
        with instance.calling("ExitInitializationMode"):
            instance.fmu.exitInitializationMode()

    def type_name(self, variable: Variable) -> str:
        """What the functions that set and get this variable are called after."""
        return "Integer" if variable.type == "Enumeration" else variable.type

    def values(self, fmu: Any, variable: Variable) -> Any:
        """Of a variable, in its own unit, an array laid out flat."""
        return getattr(fmu, f"get{self.type_name(variable)}")([variable.reference])

    def free(self, instance: Instance) -> None:
        """Free it and its library."""
        with instance.calling("FreeInstance"):
            instance.fmu.freeInstance()

    @staticmethod
    def _callbacks(standard: Any, kind: str, logger: Any) -> Any:
        """FMPy's structure of this `kind` with memory and `logger`."""
        from fmpy.logging import addLoggerProxy

        callbacks = getattr(standard, kind)()
        callbacks.logger = logger
        callbacks.allocateMemory = standard.defaultCallbacks.allocateMemory
        callbacks.freeMemory = standard.defaultCallbacks.freeMemory
        addLoggerProxy(byref(callbacks))
        return callbacks


class Fmi1(Fmi2):
    """How FMI 1.0 is spoken, which has no word for a tolerance and makes no mode of initialising."""

    def __init__(self) -> None:
        super().__init__(FMU1Drive)

    def instantiate(self, instance: Instance) -> None:
        callbacks = self._callbacks(fmi1, "fmi1CallbackFunctions", _on_message_1)
        _instances_1[0] = instance
        try:
            with instance.calling("InstantiateSlave"):
                instance.fmu.instantiate(functions=callbacks, loggingOn=False)
        finally:
            del _instances_1[0]
        if instance.fmu.component:
            _instances_1[instance.handle] = instance

    def enter(self, instance: Instance) -> None:
        instance.write(instance.settings)
        instance.write(instance.inputs)

    def leave(self, instance: Instance) -> None:
        with instance.calling("InitializeSlave"):
            instance.fmu.initialize(tStart=instance.setup.start, stopTime=instance.setup.stop)

    def free(self, instance: Instance) -> None:
        with instance.calling("TerminateSlave"), suppress(Exception):
            instance.fmu.terminate()
        with instance.calling("FreeSlaveInstance"):
            instance.fmu.freeInstance()


class Fmi3(Fmi2):
    """How FMI 3.0 is spoken. Event mode is used, and early return allowed, where the FMU has them."""

    def __init__(self, slave: type = FMU3Drive):
        super().__init__(slave)

    def instantiate(self, instance: Instance) -> None:
        fmu, abilities = instance.fmu, instance.description.model.coSimulation
        # ctypes frees what is not kept
        fmu.logMessage = fmi3.fmi3LogMessageCallback(
            lambda environment, status, category, text: instance.on_message(status, text)
        )
        ramped = [v.reference for v in instance.description.variables.values() if instance.takes_ramp(v)]
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

    def refusal_reason(self, instance: Instance) -> str:
        known = [v.name for v in instance.description.variables.values() if v.type == "Clock"]
        if known and not instance.description.model.coSimulation.hasEventMode:
            return f"it has clocks ({', '.join(known[:3])}), and states no event mode (hasEventMode): export it again"
        return super().refusal_reason(instance)

    def enter(self, instance: Instance) -> None:
        """Bring it into initialisation mode, by way of configuration mode."""
        fmu = instance.fmu
        structure = [setting for setting in instance.settings if setting[0].causality == STRUCTURAL_PARAMETER]
        if structure:
            with instance.calling("EnterConfigurationMode"):
                fmu.enterConfigurationMode()
            instance.write(structure)
            with instance.calling("ExitConfigurationMode"):
                fmu.exitConfigurationMode()
        instance.write([setting for setting in instance.settings if setting[0].causality != STRUCTURAL_PARAMETER])
        with instance.calling("EnterInitializationMode"):
            fmu.enterInitializationMode(
                tolerance=instance.setup.tolerance, startTime=instance.setup.start, stopTime=instance.setup.stop
            )
        # what belongs to a clock may be set only while that ticks
        instance.write([setting for setting in instance.inputs if not setting[0].clocks])

    def leave(self, instance: Instance) -> None:
        """Bring it from there into step mode, by way of event mode if it has that."""
        events = getattr(instance.description.interface, "hasEventMode", False)
        if events:
            with instance.calling("GetIntervalDecimal"):
                instance.clocks = clock_table(instance)
        with instance.calling("ExitInitializationMode"):
            instance.fmu.exitInitializationMode()
        if events:
            _leave_event_mode(instance)

    def type_name(self, variable: Variable) -> str:
        return NUMERIC_TYPES[variable.kind] if variable.kind >= 0 else variable.type

    def values(self, fmu: Any, variable: Variable) -> Any:
        return getattr(fmu, f"get{self.type_name(variable)}")([variable.reference], nValues=variable.size)


def _leave_event_mode(instance: Instance) -> None:
    """From event mode, into which initialisation leads, to step mode; what steps need of events is kept."""
    instance.planned = np.array([np.inf])
    instance.returned = np.zeros(MAX_RETURNED_SIZE, dtype=np.uint8)
    instance.events = np.zeros(1, dtype=EVENTS_RECORD)
    e = instance.events[0]
    e["instance"], e["step"] = instance.handle, instance.setup.step or 1.0
    e["enter_event_mode"], e["enter_step_mode"] = (instance.address(f"Enter{mode}Mode") for mode in ("Event", "Step"))
    e["update"], e["get_interval"] = instance.address("UpdateDiscreteStates"), instance.address("GetIntervalDecimal")
    e["set_clock"], e["get_clock"] = instance.address("SetClock"), instance.address("GetClock")
    e["clocks"], e["clock_table"] = len(instance.clocks), instance.clocks.ctypes.data
    e["next"], e["returned"] = instance.planned.ctypes.data, instance.returned.ctypes.data
    # compiled before the call is announced: the FMU is not to be charged with it
    settled = update_discrete_states.native.c_function
    with instance.calling("UpdateDiscreteStates"):
        status = settled(instance.events.ctypes.data, 0, -1, instance.setup.start)
    if status != 0:
        clock = instance.clock_name(int(e["culprit"]))
        instance.note["status"] = status >> STATUS_WIDTH
        bare = status & (1 << STATUS_WIDTH) - 1
        raise InputRefused(explain_status(bare, "fmi3", {}, float(e["value"]), clock, "", instance.invalid_status))
    with instance.calling("EnterStepMode"):
        instance.fmu.enterStepMode()


def clock_table(instance: Instance) -> np.ndarray:
    """The clocks of an instance in initialisation mode, (clocks,) of `cosim_step.CLOCK_RECORD`.

    Raises:
        InputRefused: a clock does not tick in whole steps.
    """
    found = clocks(instance.description)
    table = np.zeros(len(found), dtype=CLOCK_RECORD)
    for row, clock in zip(table, found, strict=True):
        row["reference"], row["kind"], row["next"] = clock.valueReference, PERIODIC_CLOCK, UNKNOWN_STEP
        if clock.causality == "output":
            row["kind"] = OUTPUT_CLOCK
        elif clock.intervalVariability == "triggered":
            row["period"], row["next"] = 1, 0
        elif clock.intervalVariability in ("changing", "countdown"):
            row["kind"] = CHANGING_CLOCK if clock.intervalVariability == "changing" else COUNTDOWN_CLOCK
            interval, known = _query_interval(instance, clock)
            row["next"] = _whole_steps(instance, clock, interval, 1) if known else UNKNOWN_STEP
        else:
            interval, shift = stated_interval(clock)
            if clock.intervalDecimal is None and clock.intervalCounter is None:
                (interval, _), asked = _query_interval(instance, clock), (c_double * 1)(0.0)
                instance.fmu.getShiftDecimal((c_uint * 1)(clock.valueReference), asked)
                shift = asked[0]
            elif clock.intervalVariability != "constant":
                instance.fmu.setIntervalDecimal((c_uint * 1)(clock.valueReference), (c_double * 1)(interval))
            row["period"] = _whole_steps(instance, clock, interval, 1)
            row["next"] = _whole_steps(instance, clock, shift, 0)
    # steps count from 0 s, clocks from the start of the run
    table["next"][table["next"] < UNKNOWN_STEP] += round(instance.setup.start / (instance.setup.step or 1.0))
    return table


def _query_interval(instance: Instance, clock: Any) -> tuple[float, bool]:
    """(interval, whether it is known) of a clock, by the FMU's own word."""
    interval, qualifier = (c_double * 1)(math.nan), (c_int * 1)(NOT_YET_KNOWN)
    instance.fmu.getIntervalDecimal((c_uint * 1)(clock.valueReference), interval, qualifier)
    return interval[0], qualifier[0] != NOT_YET_KNOWN


def _whole_steps(instance: Instance, clock: Any, interval: float, least: int) -> int:
    """`interval` (s) in whole steps of the instance, at least `least`."""
    step = instance.setup.step or math.nan
    count = interval / step
    # a thousandth of a step would add up to a step within a second
    if not (count < 1e9 and round(count) >= least and abs(count - round(count)) < 1e-6):
        raise InputRefused(
            f"clock '{clock.name}' has an interval or shift of {1e3 * interval:g} ms; the drive's step is "
            f"{1e3 * step:g} ms, and its clocks tick in whole steps: choose a tick or substeps that fit"
        )
    return round(count)


class CosimInstance(Instance):
    """An FMU instance of the kind co-simulation; arguments, errors and attributes as those of `Instance`."""

    _standards: ClassVar[Mapping[int, Any]] = {1: Fmi1(), 2: Fmi2(), 3: Fmi3()}
    _stepping: Stepping | None = None

    def advance(self, t: float, h: float) -> None:
        if self._stepping is None:
            self._stepping = Stepping(self)
            self._stepping.allow_repeats()
        stepping = self._stepping
        with self.calling("DoStep"):
            status = STEP_FUNCTION(stepping.address)(stepping.memory.ctypes.data, t, h, None, None)
        if status not in (0, 1):
            raise ComponentFailed(f"{self.description.path.name}: {stepping.explain(status)}")

    def _initialise(self) -> None:
        self._stepping = None
        super()._initialise()
