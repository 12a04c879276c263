"""Life cycle of an FMU per FMI version: load, instantiate, initialise, enter step mode.

FMI 1.0 for Co-Simulation, 4.1; FMI 2.0.4, 4.2; FMI 3.0.2, 2.3 and 4.2. The function signatures that FMPy determines
are cached, as they are equal for all FMUs of a kind. Input clocks (FMI 3.0, 2.2.8) tick at whole steps of the FMU.
"""

import math
import os
import weakref
from collections.abc import Callable, Mapping
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
from twin.kernel.fmi import cosim_step
from twin.kernel.fmi.description import STRUCTURAL_PARAMETER, clocks, stated_interval
from twin.kernel.fmi.groups import STATUS_WIDTH, explain_status, intermediate_update, status_phrase
from twin.kernel.fmi.instance import Instance
from twin.kernel.fmi.stepping import Stepping
from twin.kernel.fmi.variable import NUMERIC_TYPES, Variable

MAX_RETURNED_SIZE = 40
"""Size of the memory for values that functions of event mode return (bytes)."""

ERROR_STATUS = 3
"""Value of fmi2Error and its equivalents."""

NOT_YET_KNOWN = 0
"""Value of fmi3IntervalNotYetKnown."""

_complete: set[str] = set()
"""Paths of binaries that are known to have every function."""
_NEVER_CALLED = CFUNCTYPE(c_int)
_OTHER_KIND_FUNCTIONS = {
    "fmi3ActivateModelPartition",
    "fmi3DoStep",
    "fmi3EnterStepMode",
    "fmi3GetOutputDerivatives",
    "fmi3InstantiateCoSimulation",
    "fmi3InstantiateScheduledExecution",
}
_forgiven: list[list[str]] = []
"""Lists for the missing functions of the binary being loaded; empty if missing functions are errors."""
_instances_1: weakref.WeakValueDictionary[int, Instance] = weakref.WeakValueDictionary()
"""FMI 1.0 instances by the address of the FMU's own instance; key 0 for the one being created."""
_instances_2: weakref.WeakValueDictionary[int, Instance] = weakref.WeakValueDictionary()
"""FMI 2.0 instances by the environment pointer that the FMU passes to the logger."""


class _LazyFunctions(dict[str, Any]):
    """FMI functions of an FMU instance by name, looked up on first use: a run calls a third of them."""

    def __init__(self, slave: "_SignatureCache"):
        super().__init__()
        # a weak reference, as the slave owns this object
        self._slave = proxy(slave)

    def __missing__(self, name: str) -> Any:
        self[name] = found = self._slave._function(name)
        return found


class _LenientLibrary:
    """An FMU's library with functions that return an error in place of missing ones."""

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


class CallFailure(Exception):
    """Error that an FMU function returned a status worse than a warning."""


class _SignatureCache:
    """Mixin for FMPy's classes that reuses the function signatures determined for the first binary of this process.

    FMPy derives them from its own methods with `inspect`, which takes some milliseconds per instance. The binary itself
    is loaded and released for each instance, so that its static memory does not persist from one run to the next.
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
        # FMPy's version would accept negative integers as fmi2OK
        function = self._functions[name]
        status = function(*arguments)
        if function.restype is c_int and status not in (0, 1):
            raise CallFailure(status_phrase(name.replace("fmi1", "fmi"), status))
        return status

    def _function(self, name: str) -> Any:
        function = getattr(self.dll, self._exported_name(name))
        function.argnames, function.argtypes, function.restype = type(self)._signatures[name]
        return function

    def _exported_name(self, name: str) -> str:
        return name

    def _signature(self, name: str, function: Any) -> tuple[Any, ...]:
        return function.argnames, function.argtypes, function.restype


# FMPy recognises the FMI version by the class name
class FMU1Drive(_SignatureCache, FMU1Slave):
    """FMPy's FMI 1.0 co-simulation instance, with cached signatures; the model identifier prefixes function names."""

    def _exported_name(self, name: str) -> str:
        return f"{self.modelIdentifier}_{name.replace('fmi1', 'fmi')}"

    def _signature(self, name: str, function: Any) -> tuple[Any, ...]:
        # FMPy declares some functions that return a status as returning text; dereferencing a bad status would crash
        if not name.endswith(("Version", "TypesPlatform")) and function.restype is c_char_p:
            function.restype = c_int
        return super()._signature(name, function)


class FMU2Drive(_SignatureCache, FMU2Slave):
    """FMPy's FMI 2.0 co-simulation instance, with cached signatures."""


class FMU3Drive(_SignatureCache, FMU3Slave):
    """FMPy's FMI 3.0 co-simulation instance, with cached signatures."""


class FMU2Exchange(_SignatureCache, FMU2Model):
    """FMPy's FMI 2.0 model-exchange instance, with cached signatures."""


class FMU3Exchange(_SignatureCache, FMU3Model):
    """FMPy's FMI 3.0 model-exchange instance, with cached signatures."""

    def __dir__(self) -> list[str]:
        # FMPy requires all functions listed here, but a binary may lack the functions of other kinds (FMI 3.0, 2.1.2)
        return [name for name in super().__dir__() if name not in _OTHER_KIND_FUNCTIONS]


@fmi1.fmi1CallbackLoggerTYPE
def _on_message_1(component: int | None, instance: bytes, status: int, category: bytes, message: bytes) -> None:
    """Forward a log message of an FMI 1.0 FMU to its instance; see `_on_message_2`."""
    # the instance being created first: its address may have belonged to a freed one
    owner = _instances_1.get(0) or _instances_1.get(component or 0)
    if owner is not None:
        owner.on_message(status, message)


@fmi2.fmi2CallbackLoggerTYPE
def _on_message_2(environment: int | None, instance: bytes, status: int, category: bytes, message: bytes) -> None:
    """Forward a log message of an FMI 2.0 FMU to its instance.

    FMPy's proxy calls the logger given last, for all FMUs: it has to serve all instances and outlive them.
    """
    owner = _instances_2.get(environment or 0)
    if owner is not None:
        owner.on_message(status, message)


class Fmi2:
    """Life cycle of an FMI 2.0 FMU: calls that instantiate, initialise and free it; `slave` is FMPy's class."""

    def __init__(self, slave: Callable[..., Any]):
        self.slave = slave

    def load_binary(self, instance: Instance) -> Any:
        """Load the FMU's binary; return FMPy's instance. Missing functions are recorded in lenient mode."""
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
        """Instantiate the FMU; the instance is NULL if it refuses."""
        callbacks = self._callbacks(fmi2, "fmi2CallbackFunctions", _on_message_2)
        callbacks.componentEnvironment = id(instance)
        _instances_2[id(instance)] = instance
        with instance.calling("Instantiate"):
            instance.fmu.instantiate(callbacks=callbacks, loggingOn=False)

    def refusal_reason(self, instance: Instance) -> str:
        guid = instance.description.model.guid
        return f"the GUID {guid} in modelDescription.xml may not be the binary's own: export it again"

    def initialise(self, instance: Instance) -> None:
        self.enter(instance)
        self.leave(instance)

    def enter(self, instance: Instance) -> None:
        """Set the FMU's start values and enter initialisation mode."""
        instance.write(instance.settings)
        setup = instance.setup
        instance.call("SetupExperiment", tolerance=setup.tolerance, startTime=setup.start, stopTime=setup.stop)
        instance.call("EnterInitializationMode")
        instance.write(instance.inputs)

    def leave(self, instance: Instance) -> None:
        """Leave the FMU's initialisation mode and enter step mode."""
        instance.call("ExitInitializationMode")

    def type_name(self, variable: Variable) -> str:
        """Return the type in the names of the FMI functions that set and get a variable, such as "Real"."""
        return "Integer" if variable.type == "Enumeration" else variable.type

    def values(self, fmu: Any, variable: Variable) -> Any:
        return getattr(fmu, f"get{self.type_name(variable)}")([variable.reference])

    def free(self, instance: Instance) -> None:
        instance.call("FreeInstance")

    @staticmethod
    def _callbacks(standard: Any, kind: str, logger: Any) -> Any:
        from fmpy.logging import addLoggerProxy

        callbacks = getattr(standard, kind)()
        callbacks.logger = logger
        callbacks.allocateMemory = standard.defaultCallbacks.allocateMemory
        callbacks.freeMemory = standard.defaultCallbacks.freeMemory
        addLoggerProxy(byref(callbacks))
        return callbacks


class Fmi1(Fmi2):
    """Life cycle of an FMI 1.0 FMU, which has neither a tolerance nor an initialisation mode."""

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
    """Life cycle of an FMI 3.0 FMU, with event mode and early return if the FMU supports them."""

    def instantiate(self, instance: Instance) -> None:
        fmu, abilities = instance.fmu, instance.description.model.coSimulation
        # stored, as ctypes frees a callback without references
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
        """Set the FMU's structural parameters in configuration mode and start values; enter initialisation mode."""
        setup = instance.setup
        structure = [setting for setting in instance.settings if setting[0].causality == STRUCTURAL_PARAMETER]
        if structure:
            instance.call("EnterConfigurationMode")
            instance.write(structure)
            instance.call("ExitConfigurationMode")
        instance.write([setting for setting in instance.settings if setting[0].causality != STRUCTURAL_PARAMETER])
        instance.call("EnterInitializationMode", tolerance=setup.tolerance, startTime=setup.start, stopTime=setup.stop)
        # a clocked input may be set only while its clock ticks
        instance.write([setting for setting in instance.inputs if not setting[0].clocks])

    def leave(self, instance: Instance) -> None:
        """Leave the FMU's initialisation mode and enter step mode, through event mode if the FMU has it."""
        events = getattr(instance.description.interface, "hasEventMode", False)
        if events:
            with instance.calling("GetIntervalDecimal"):
                instance.clocks = clock_table(instance)
        instance.call("ExitInitializationMode")
        if events:
            _leave_event_mode(instance)

    def type_name(self, variable: Variable) -> str:
        return NUMERIC_TYPES[variable.kind] if variable.kind >= 0 else variable.type

    def values(self, fmu: Any, variable: Variable) -> Any:
        return getattr(fmu, f"get{self.type_name(variable)}")([variable.reference], nValues=variable.size)


def _leave_event_mode(instance: Instance) -> None:
    """Handle the FMU's initial event and enter step mode; stores the data that steps need for events."""
    instance.planned = np.array([np.inf])
    instance.returned = np.zeros(MAX_RETURNED_SIZE, dtype=np.uint8)
    instance.events = np.zeros(1, dtype=cosim_step.EVENTS_RECORD)
    e = instance.events[0]
    e["instance"], e["step"] = instance.handle, instance.setup.step or 1.0
    e["enter_event_mode"], e["enter_step_mode"] = (instance.address(f"Enter{mode}Mode") for mode in ("Event", "Step"))
    e["update"], e["get_interval"] = instance.address("UpdateDiscreteStates"), instance.address("GetIntervalDecimal")
    e["set_clock"], e["get_clock"] = instance.address("SetClock"), instance.address("GetClock")
    e["clocks"], e["clock_table"] = len(instance.clocks), instance.clocks.ctypes.data
    e["next"], e["returned"] = instance.planned.ctypes.data, instance.returned.ctypes.data
    # compiled before the call is announced, so that the compile time is not attributed to the FMU
    settled = cosim_step.update_discrete_states.native.c_function
    with instance.calling("UpdateDiscreteStates"):
        status = settled(instance.events.ctypes.data, 0, -1, instance.setup.start)
    if status != 0:
        clock = instance.clock_name(int(e["culprit"]))
        instance.note["status"] = status >> STATUS_WIDTH
        bare = status & (1 << STATUS_WIDTH) - 1
        raise InputRefused(explain_status(bare, "fmi3", {}, float(e["value"]), clock, "", instance.invalid_status))
    instance.call("EnterStepMode")


def clock_table(instance: Instance) -> np.ndarray:
    """Make the table of an FMU instance's clocks in initialisation mode, (clocks,) of `cosim_step.CLOCK_RECORD`."""
    found = clocks(instance.description)
    asked_kinds = {"changing": cosim_step.CHANGING_CLOCK, "countdown": cosim_step.COUNTDOWN_CLOCK}
    table = np.zeros(len(found), dtype=cosim_step.CLOCK_RECORD)
    for row, clock in zip(table, found, strict=True):
        row["reference"], row["kind"] = clock.valueReference, cosim_step.PERIODIC_CLOCK
        row["next"] = cosim_step.UNKNOWN_STEP
        if clock.causality == "output":
            row["kind"] = cosim_step.OUTPUT_CLOCK
        elif clock.intervalVariability == "triggered":
            row["period"], row["next"] = 1, 0
        elif clock.intervalVariability in asked_kinds:
            row["kind"] = asked_kinds[clock.intervalVariability]
            interval, known = _query_interval(instance, clock)
            row["next"] = _whole_steps(instance, clock, interval, 1) if known else cosim_step.UNKNOWN_STEP
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
    # steps are counted from 0 s, clock intervals from the start of the run
    table["next"][table["next"] < cosim_step.UNKNOWN_STEP] += round(instance.setup.start / (instance.setup.step or 1.0))
    return table


def _query_interval(instance: Instance, clock: Any) -> tuple[float, bool]:
    """Query the interval of an FMU's clock; return (interval (s), whether it is known)."""
    interval, qualifier = (c_double * 1)(math.nan), (c_int * 1)(NOT_YET_KNOWN)
    instance.fmu.getIntervalDecimal((c_uint * 1)(clock.valueReference), interval, qualifier)
    return interval[0], qualifier[0] != NOT_YET_KNOWN


def _whole_steps(instance: Instance, clock: Any, interval: float, least: int) -> int:
    """Convert a clock's interval (s) to a whole number of steps, at least `least`; refuse other intervals."""
    step = instance.setup.step or math.nan
    count = interval / step
    # a tolerance of a thousandth would accumulate to a whole step within a second
    if not (count < 1e9 and round(count) >= least and abs(count - round(count)) < 1e-6):
        raise InputRefused(
            f"clock '{clock.name}' has an interval or shift of {1e3 * interval:g} ms; the drive's step is "
            f"{1e3 * step:g} ms, and its clocks tick in whole steps: choose a tick or substeps that fit"
        )
    return round(count)


class CosimInstance(Instance):
    """An FMU instance for co-simulation, initialised and ready to step; errors and attributes as of `Instance`."""

    _standards: ClassVar[Mapping[int, Any]] = {1: Fmi1(FMU1Drive), 2: Fmi2(FMU2Drive), 3: Fmi3(FMU3Drive)}
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
