"""One FMU instance through FMPy: loaded, instantiated, initialised, freed. Nothing here is called while stepping."""

import ctypes
import os
import weakref
from collections.abc import Callable, Sequence
from contextlib import AbstractContextManager
from ctypes import byref, c_void_p
from pathlib import Path
from typing import Any, ClassVar, NamedTuple

import numpy as np
from fmpy import fmi2

from twin.drive.adapter import KINDS
from twin.drive.announcement import announced
from twin.drive.description import FmuDescription, Variable
from twin.drive.slave import FMU2Drive, FMU3Drive
from twin.errors import ComponentFailed, InputRefused


class Setup(NamedTuple):
    """What an FMU is told of the run before it is initialised.

    Attributes:
        tolerance: relative, of its solver; None: nothing is said.
        stop: time of the last step's end (s); None: nothing is said, and some FMUs then end where they like to.
    """

    tolerance: float | None = None
    stop: float | None = None


Setting = tuple[Variable, float | np.ndarray]
"""A variable and what to set it to, in its own unit; an array takes one value for all elements or one for each."""

MOST_UNHEARD = 100
"""An FMU that complains in every step is believed after so many."""

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


class Instance:
    """An FMU instance in step mode.

    Args:
        name: FMI's instance name.
        description: the checked FMU.
        folder: where it is unpacked.
        settings: values set before initialisation, in the FMU's own units.
        inputs: values set in initialisation mode.
        setup: of the run.

    Attributes:
        handle: address of the instance.
        messages: the last things it logged as warnings or errors.
        clock: its first element is the tick at which it is stepped.
        folder, settings, setup: the arguments.

    Raises:
        InputRefused: it cannot be loaded, instantiated or initialised.
    """

    _classes: ClassVar[dict[int, type[Any]]] = {2: FMU2Drive, 3: FMU3Drive}
    """FMPy's, by version."""

    def __init__(
        self,
        name: str,
        description: FmuDescription,
        folder: Path,
        settings: Sequence[Setting] = (),
        inputs: Sequence[Setting] = (),
        setup: Setup = Setup(),  # noqa: B008, it is frozen
    ):
        self.description = description
        self.name = name
        self.messages: list[str] = []
        self.clock = np.zeros(1, dtype=np.int64)
        self._unheard: list[tuple[int, str]] = []
        self.folder, self.settings, self._inputs, self.setup = folder, settings, inputs, setup
        self._fmu = self._loaded()
        self._instantiate()
        self._initialise()

    @property
    def handle(self) -> int:
        return int(self._fmu.component)

    def address(self, function: str) -> int:
        """Of one of its FMI functions, without prefix: `DoStep`."""
        function = f"fmi{self.description.version}{function}"
        return ctypes.cast(getattr(self._fmu.dll, function), c_void_p).value or 0

    def read(self, variables: Sequence[Variable]) -> np.ndarray:
        """Values of `variables`, arrays laid out flat, in the FMU's own units."""
        with self._calling("Get"):
            return np.array([value for v in variables for value in self._get(v)], dtype=float)

    def write(self, settings: Sequence[Setting]) -> None:
        """Set variables; the FMU decides whether it may be done now."""
        with self._calling("Set"):
            for variable, value in settings:
                self._set(variable, value)

    def advance(self, t: float, h: float) -> None:
        """One step from `t` to `t` + `h` (s), after which a saved state may be restored.

        Raises:
            ComponentFailed: it returned more than a warning.
        """
        self._called("DoStep", lambda: self._fmu.doStep(t, h, False))

    def reset(self) -> None:
        """FMI's reset, then initialised as the first time.

        Raises:
            ComponentFailed: it refuses. InputRefused: it cannot be initialised again.
        """
        self._called("Reset", self._fmu.reset)
        self._initialise()

    def begin_again(self, settings: Sequence[Setting], inputs: Sequence[Setting], setup: Setup) -> None:
        """FMI's reset, then initialised with other values, with nothing to say of the time before.

        Raises:
            ComponentFailed: it refuses. InputRefused: it cannot be initialised again.
        """
        self.settings, self._inputs, self.setup = settings, inputs, setup
        self.clock = np.zeros(1, dtype=np.int64)
        self.messages.clear()
        self._unheard.clear()
        self.reset()

    def saved_state(self) -> Any:
        """Its state, to be given to `restore`.

        Raises:
            ComponentFailed: it refuses.
        """
        return self._called("GetFMUstate", self._fmu.getFMUState)

    def restore(self, state: Any) -> None:
        """Go back to `state` and free that.

        Raises:
            ComponentFailed: it refuses.
        """
        self._called("SetFMUstate", lambda: self._fmu.setFMUState(state))
        self._called("FreeFMUstate", lambda: self._fmu.freeFMUState(state))

    def forget(self, state: int) -> None:
        """Free the state at address `state`.

        Raises:
            ComponentFailed: the FMU does not.
        """
        self._called("FreeFMUstate", lambda: self._fmu.freeFMUState(c_void_p(state)))

    def unheard(self) -> list[tuple[int, str]]:
        """(tick, text) of what it logged since this was last asked, at most `MOST_UNHEARD` of them."""
        told, self._unheard = self._unheard, []
        return told

    def close(self) -> None:
        """Free it; safe to call twice."""
        if self._fmu is not None and self._fmu.component:
            with self._calling("FreeInstance"):
                self._fmu.freeInstance()
        self._fmu = None

    def _calling(self, function: str) -> AbstractContextManager[None]:
        return announced(self.description.path.name, self.name, f"fmi{self.description.version}{function}")

    def _loaded(self) -> Any:
        description, here = self.description, os.getcwd()
        kind = self._classes[description.version]
        try:
            with announced(description.path.name, self.name, "the loading of its binary"):
                return kind(
                    guid=description.model.guid,
                    unzipDirectory=str(self.folder),
                    modelIdentifier=description.identifier,
                    instanceName=self.name,
                )
        # FMPy raises bare Exception for a library that does not load or lacks a function, ctypes AttributeError
        except Exception as problem:
            raise InputRefused(f"{description.path}: its binary does not load: {problem}") from None
        # FMPy goes to the library's folder to load it, and stays there if that fails
        finally:
            os.chdir(here)

    def _instantiate(self) -> None:
        heard: dict[str, Any] = {"logMessage": lambda environment, status, category, said: self.hear(status, said)}
        try:
            if self.description.version == 2:
                from fmpy.logging import addLoggerProxy

                callbacks = fmi2.fmi2CallbackFunctions()
                callbacks.logger = _logged
                callbacks.componentEnvironment = id(self)
                _SPEAKERS[id(self)] = self
                callbacks.allocateMemory = fmi2.defaultCallbacks.allocateMemory
                callbacks.freeMemory = fmi2.defaultCallbacks.freeMemory
                addLoggerProxy(byref(callbacks))
                heard = {"callbacks": callbacks}
            with self._calling("Instantiate"):
                self._fmu.instantiate(**heard, loggingOn=False)
        # FMPy turns a NULL instance into a bare Exception
        except Exception:
            self._fmu.component = None
        if not self._fmu.component:
            clocks = [v.name for v in self.description.variables.values() if v.type == "Clock"]
            why = (
                f"it may want its clocks ({', '.join(clocks[:3])}) served in event mode, which twin does not do"
                if clocks
                else f"the GUID {self.description.model.guid} in modelDescription.xml may not be the binary's own: "
                "export it again"
            )
            raise InputRefused(
                f"{self.description.path}: fmi{self.description.version}Instantiate refused{self._said()}; {why}"
            )

    def _initialise(self) -> None:
        start = {"tolerance": self.setup.tolerance, "startTime": 0.0, "stopTime": self.setup.stop}
        try:
            self.write(self.settings)
            if self.description.version == 2:
                with self._calling("SetupExperiment"):
                    self._fmu.setupExperiment(**start)
                start = {}
            with self._calling("EnterInitializationMode"):
                self._fmu.enterInitializationMode(**start)
            self.write(self._inputs)
            with self._calling("ExitInitializationMode"):
                self._fmu.exitInitializationMode()
        # FMPy's FMICallException and whatever is below it: this FMU cannot be used
        except Exception as problem:
            self.close()
            raise InputRefused(f"{self.description.path}: cannot be initialised: {problem}{self._said()}") from None

    def _set(self, variable: Variable, value: float | np.ndarray) -> None:
        values = np.broadcast_to(value, variable.size).tolist()
        if variable.type == "Boolean":
            values = [v > 0.5 for v in values]
        elif variable.type not in ("Real", "Float64", "Float32"):
            values = [round(v) for v in values]
        getattr(self._fmu, f"set{self.type_name(variable)}")([variable.reference], values)

    def _get(self, variable: Variable) -> Sequence[float]:
        read = getattr(self._fmu, f"get{self.type_name(variable)}")
        if self.description.version == 2:
            return read([variable.reference])
        return read([variable.reference], nValues=variable.size)

    def type_name(self, variable: Variable) -> str:
        """What the FMI's set and get functions of this variable are called after."""
        if self.description.version == 2:
            return "Integer" if variable.type == "Enumeration" else variable.type
        return KINDS[variable.kind]

    def _called(self, function: str, call: Callable[[], Any]) -> Any:
        try:
            with self._calling(function):
                return call()
        # FMPy's FMICallException, or ctypes where the binary lacks the function
        except Exception as problem:
            name = f"fmi{self.description.version}{function}"
            raise ComponentFailed(f"{self.description.path.name}: {name} failed: {problem}{self._said()}") from None

    def _said(self) -> str:
        return f" (it said: {'; '.join(self.messages)})" if self.messages else ""

    def hear(self, status: int, message: bytes | None) -> None:
        """Keep what it logged, if it is a warning or worse."""
        if status > 0 and message:
            text = message.decode(errors="replace").strip()
            del self.messages[:-2]
            self.messages.append(text)
            if len(self._unheard) < MOST_UNHEARD:
                self._unheard.append((int(self.clock[0]), text))
