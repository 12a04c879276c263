"""FMU instances through FMPy: loading, instantiation, initialisation, access to variables and states, release."""

import ctypes
import os
import re
from collections.abc import Callable, Iterator, Mapping, Sequence
from contextlib import contextmanager, suppress
from ctypes import c_void_p
from pathlib import Path
from typing import Any, ClassVar

import numpy as np

from twin.kernel.errors import ComponentFailed, InputRefused
from twin.kernel.fmi import floating_point, groups
from twin.kernel.fmi.cosim_step import CLOCK_RECORD
from twin.kernel.fmi.description import FmuDescription, clocks
from twin.kernel.fmi.variable import MAX_EXACT, TEXT_TYPES, Setting, Setup, Variable

MAX_PENDING_MESSAGES = 100
"""Maximum number of pending messages; an FMU may log one in every step."""

REFERENCE_PATTERN = re.compile(r"#(?P<type>[rbis])(?P<reference>\d+)#|##")
LOGGED_TYPES = {"r": ("Real",), "b": ("Boolean",), "i": ("Integer", "Enumeration"), "s": ("String",)}
"""References to variables in log messages, and variable types by the letter in a reference."""


def working_directory() -> str:
    """Return the process's working directory; "" if it has been deleted."""
    with suppress(OSError):
        return os.getcwd()
    return ""


class Instance:
    """An FMU instance, initialised and ready to step; subclasses implement the kinds of FMUs.

    Methods that call the FMU raise `ComponentFailed` if it refuses; InputRefused if it cannot be loaded, instantiated
    or initialised. `settings` are set before initialisation, in the FMU's units, and `inputs` in initialisation mode.

    Attributes:
        messages: last warnings and errors that it logged.
        pending_messages: (tick, text) of the messages to be reported.
        missing: functions missing in its binary, accepted in lenient mode.
        clock: the first element is the tick being stepped.
        stepped: whether it is part of a simulation that has begun.
        standard: implementation of its FMI version, a `lifecycle.Fmi2` or subclass.
        fmu: FMPy's instance; None once freed.
        ramp: `groups.RAMP_RECORD` of the inputs that are interpolated over a step.
        clocks, planned, returned, events: `cosim_step.CLOCK_RECORD` of each clock, time of the next event, memory for
            returned values, and `cosim_step.EVENTS_RECORD`, or None without event mode.
    """

    _standards: ClassVar[Mapping[int, Any]]

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
        self.missing: list[str] = []
        self.clock, self.stepped = np.zeros(1, dtype=np.int64), False
        self._here, self._moved = working_directory(), False
        self._mode, self._mode_changed = floating_point.mode(), False
        self.pending_messages: list[tuple[int, str]] = []
        self.folder, self.settings, self.inputs, self.setup = folder, settings, inputs, setup
        self.standard = self._standards[description.version]
        self.note = np.zeros(1, dtype=groups.NOTE_RECORD)
        self.ramp = np.zeros(1, dtype=groups.RAMP_RECORD)
        self.ramp["note"] = self.note.ctypes.data
        self.clocks = np.zeros(0, dtype=CLOCK_RECORD)
        self.planned, self.returned = np.array([np.inf]), np.zeros(0, dtype=np.uint8)
        self.events: np.ndarray | None = None
        self.fmu = self._load_binary()
        self._instantiate()
        if setup.waiting:
            self._enter_mode(self.standard.enter)
        else:
            self._initialise()

    @property
    def handle(self) -> int:
        """Address of the FMU's own instance."""
        return int(self.fmu.component)

    def address(self, function: str) -> int:
        """Return the address of the FMU's FMI function, given without prefix: `DoStep`."""
        function = self.description.exported_name(function)
        return ctypes.cast(getattr(self.fmu.dll, function), c_void_p).value or 0

    def takes_ramp(self, variable: Variable) -> bool:
        """Whether `variable` is an FMU input that the setup and the FMU allow to interpolate over a step."""
        abilities = self.description.model.coSimulation
        if not self.setup.ramped or variable.causality != "input" or variable.variability != "continuous":
            return False
        if self.description.version < 3:
            return abilities.canInterpolateInputs and variable.type == "Real"
        return abilities.providesIntermediateUpdate and variable.intermediate and variable.type == "Float64"

    def clock_bits(self, variable: Variable) -> int:
        """Return the FMU's clocks that `variable` depends on as a bit mask; 0 for a variable without clocks."""
        return sum(1 << n for n, reference in enumerate(self.clocks["reference"]) if reference in variable.clocks)

    def clock_name(self, index: int) -> str:
        return next((clock.name for clock in clocks(self.description)[index : index + 1]), "?")

    @property
    def schedule(self) -> list[np.ndarray]:
        """Arrays that steps change outside the FMU's own state: due times of events and clocks."""
        return [self.clocks, self.planned]

    @property
    def invalid_status(self) -> int:
        """Last status outside the FMI standard that an FMU function returned in a step."""
        return int(self.note["status"].astype(np.int32)[0])

    def values(self, variable: Variable) -> list[Any]:
        """Read the exact values of an FMU variable in its own unit, an array flattened."""
        with self.calling("Get"), self._variable_errors(variable):
            return list(self.standard.values(self.fmu, variable))

    def read_floats(self, variables: Sequence[Variable]) -> np.ndarray:
        """Read the values of FMU variables as doubles in the FMU's units, arrays flattened."""
        found = [(v, value) for v in variables for value in self.values(v)]
        for v, value in found:
            if isinstance(value, int) and abs(value) > MAX_EXACT:
                raise ComponentFailed(f"{self.label} {inexact_phrase(v.name, v.type, value)}{self.start_phrase}")
        return np.array([value for _, value in found], dtype=float)

    def write(self, settings: Sequence[Setting]) -> None:
        """Set FMU variables to values; the FMU decides whether that is allowed in its present mode."""
        with self.calling("Set"):
            for variable, value in settings:
                with self._variable_errors(variable):
                    self._set_variable(variable, value)

    @property
    def label(self) -> str:
        """File and name of the FMU, the prefix of its error messages."""
        return f"{self.description.path.name} ({self.name})"

    @contextmanager
    def _variable_errors(self, variable: Variable) -> Iterator[None]:
        try:
            yield
        except UnfitValue as problem:
            raise ComponentFailed(f"{self.label} gets {problem}{self.start_phrase}") from None
        # FMICallException of FMPy, or an exception of ctypes for an argument
        except Exception as problem:
            text = f"{problem} for {variable.name}{self.start_phrase}"
            raise ComponentFailed(f"{self.label} {text}{self._quoted_messages()}") from None

    def advance(self, t: float, h: float) -> None:
        """Advance the FMU from `t` to `t` + `h` (s); a saved state may be restored afterwards."""
        raise NotImplementedError

    def begin(self) -> None:
        """Take an FMU instance that was created `waiting` from initialisation mode to step mode."""
        self._enter_mode(self.standard.leave)

    def reset(self) -> None:
        self._call("Reset", self.fmu.reset)
        self._initialise()

    def save_state(self) -> Any:
        """Save the FMU's state; return a pointer for `restore_state` and `free_state`."""
        return self._call("GetFMUstate", self.fmu.getFMUState)

    def restore_state(self, state: Any) -> None:
        """Restore a saved FMU state, which remains valid."""
        self._call("SetFMUstate", lambda: self.fmu.setFMUState(state))

    def serialize_state(self, state: Any) -> bytes:
        """Serialise a saved FMU state to bytes, for storage or another process."""
        return self._call("SerializeFMUstate", lambda: self.fmu.serializeFMUState(state))

    def deserialize_state(self, content: bytes) -> Any:
        """Create an FMU state from serialised bytes, possibly of another process."""
        return self._call("DeSerializeFMUstate", lambda: self.fmu.deserializeFMUState(content))

    def free_state(self, state: int) -> None:
        """Free the saved FMU state at address `state`."""
        self._call("FreeFMUstate", lambda: self.fmu.freeFMUState(c_void_p(state)))

    def pop_messages(self) -> list[tuple[int, str]]:
        """Return and clear the FMU's pending messages (tick, text), at most `MAX_PENDING_MESSAGES`."""
        # steps are not announced individually, so the working directory is checked here
        self.return_to(self._here)
        self.restore_mode(self._mode)
        messages, self.pending_messages = self.pending_messages, []
        return messages

    def close(self) -> None:
        """Free the FMU instance; safe to call twice."""
        if self.fmu is not None and self.fmu.component:
            self.standard.free(self)
        self.fmu = None

    def call(self, function: str, **arguments: Any) -> Any:
        """Call an FMI function by FMPy's method of the same name, announced to the hooks."""
        with self.calling(function):
            return getattr(self.fmu, function[0].lower() + function[1:])(**arguments)

    @contextmanager
    def calling(self, function: str) -> Iterator[None]:
        """Announce a call of an FMI function to the hooks; afterwards restore the folder and floating-point mode."""
        here, mode = working_directory(), floating_point.mode()
        try:
            with groups.announce_call(self.description.path.name, self.name, f"{self.description.prefix}{function}"):
                yield
        finally:
            self.return_to(here)
            self.restore_mode(mode)

    def return_to(self, folder: str) -> None:
        """Restore the working directory `folder` if the FMU has changed it; reported once."""
        if folder and working_directory() != folder:
            os.chdir(folder)
            if not self._moved:
                self._moved = True
                self.report("changed the working directory; it is back where it was")

    def restore_mode(self, mode: floating_point.Mode) -> None:
        """Set the floating-point mode to `mode` if the FMU has changed it; a message reports that once."""
        if floating_point.mode() != mode:
            floating_point.set_mode(mode)
            if not self._mode_changed:
                self._mode_changed = True
                self.report("changed the floating-point mode (rounding, tiny numbers); it is as it was")

    @property
    def start_phrase(self) -> str:
        """Suffix " at the start" for errors before the first step; "" later."""
        return "" if self.stepped else " at the start"

    def _load_binary(self) -> Any:
        description, here, mode = self.description, working_directory(), floating_point.mode()
        try:
            with groups.announce_call(description.path.name, self.name, "the loading of its binary"):
                return self.standard.load_binary(self)
        # FMPy raises bare Exception for a library that does not load or lacks a function, ctypes AttributeError
        except Exception as problem:
            raise InputRefused(f"{description.path}: its binary does not load: {problem}") from None
        # FMPy changes to the library's folder to load it, and remains there on failure; loading a library built with
        # gcc -Ofast changes the floating-point mode
        finally:
            os.chdir(here)
            self.restore_mode(mode)

    def _instantiate(self) -> None:
        try:
            self.standard.instantiate(self)
        # FMPy turns a NULL instance into a bare Exception
        except Exception:
            self.fmu.component = None
        if not self.fmu.component:
            raise InputRefused(
                f"{self.description.path}: {self.description.prefix}Instantiate refused{self._quoted_messages()}; "
                f"{self.standard.refusal_reason(self)}"
            )

    def _initialise(self) -> None:
        self._enter_mode(self.standard.initialise)

    def _enter_mode(self, by: Callable[["Instance"], None]) -> None:
        try:
            by(self)
        # any exception, such as FMPy's FMICallException, means that this FMU cannot be used
        except Exception as problem:
            self.close()
            quoted = "" if isinstance(problem, ComponentFailed) else self._quoted_messages()
            text = str(problem).removeprefix(f"{self.label} ")
            raise InputRefused(f"{self.description.path}: cannot be initialised: {text}{quoted}") from None

    def _set_variable(self, variable: Variable, value: Any) -> None:
        values = value if variable.is_text else np.broadcast_to(value, variable.size).tolist()
        for one in [] if variable.is_text else values:
            if variable.range_error(one):
                raise UnfitValue(f"{one:.17g} for {variable.name}, {variable.range_phrase}")
        if variable.type == "Boolean":
            values = [v > 0.5 for v in values]
        elif variable.type not in ("Real", "Float64", "Float32", *TEXT_TYPES):
            values = [round(v) for v in values]
        getattr(self.fmu, f"set{self.standard.type_name(variable)}")([variable.reference], values)

    def _call(self, function: str, call: Callable[[], Any]) -> Any:
        try:
            with self.calling(function):
                return call()
        # FMICallException of FMPy, or an exception of ctypes if the binary lacks the function
        except Exception as problem:
            name = f"{self.description.prefix}{function}"
            raise ComponentFailed(
                f"{self.description.path.name}: {name} failed: {problem}{self._quoted_messages()}"
            ) from None

    def _quoted_messages(self) -> str:
        return f" (it logged: {'; '.join(self.messages)})" if self.messages else ""

    def on_message(self, status: int, message: bytes | None) -> None:
        """Store and report a log message of the FMU with a status of warning or worse."""
        if status > 0 and message:
            text = REFERENCE_PATTERN.sub(self._variable_name, message.decode(errors="replace")).strip()
            # a repeated message is reported once
            if text in self.messages:
                self.messages.remove(text)
            del self.messages[:-2]
            self.messages.append(text)
            self.report(text)

    def report(self, text: str) -> None:
        """Append a message to the pending messages of the FMU, with the present tick."""
        if len(self.pending_messages) < MAX_PENDING_MESSAGES:
            self.pending_messages.append((int(self.clock[0]), text))

    def _variable_name(self, reference: re.Match[str]) -> str:
        """Return the variable name for a reference `#r12#` in an FMU's log message (FMI 2.0.4, 2.1.5), if known."""
        if reference[0] == "##":
            return "#"
        types, number = LOGGED_TYPES[reference["type"]], int(reference["reference"])
        found = (v.name for v in self.description.variables.values() if v.reference == number and v.type in types)
        return next(found, reference[0])


class UnfitValue(ValueError):
    """Error that a value is outside the range of an FMU variable's type."""


def inexact_phrase(name: str, type_name: str, value: int) -> str:
    """Describe an FMU's integer output that a double cannot represent exactly, as a verb phrase."""
    return f"returned {value} for {name} ({type_name}), beyond the integers that signals represent exactly (2^53)"
