"""An FMU instance through FMPy: it is loaded, instantiated, initialised, read, written and freed here."""

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
from twin.kernel.fmi import groups
from twin.kernel.fmi.cosim_step import CLOCK_RECORD
from twin.kernel.fmi.description import FmuDescription, clocks
from twin.kernel.fmi.variable import MAX_EXACT, TEXT_TYPES, Setting, Setup, Variable

MAX_PENDING_MESSAGES = 100
"""An FMU that complains in every step is believed after so many."""

REFERENCE_PATTERN = re.compile(r"#(?P<type>[rbis])(?P<reference>\d+)#|##")
LOGGED_TYPES = {"r": ("Real",), "b": ("Boolean",), "i": ("Integer", "Enumeration"), "s": ("String",)}
"""A variable in a log message, and its types by the letter there."""


def working_directory() -> str:
    """The working directory; "" if it is gone."""
    with suppress(OSError):
        return os.getcwd()
    return ""


class Instance:
    """An FMU instance where it can be stepped; of each kind there is a class, which knows the standards.

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
        missing: functions that its binary lacks, which was forgiven.
        clock: its first element is the tick at which it is stepped.
        stepped: whether it is part of a simulation that has begun.
        folder, settings, inputs, setup: the arguments.
        standard: how its version of the FMI is spoken, a `lifecycle.Fmi2` or one derived from it.
        fmu: what FMPy made of it; None once it is freed.
        ramp: `groups.RAMP_RECORD` of its inputs that are lines over a step.
        clocks, planned, returned, events: `cosim_step.CLOCK_RECORD` of each, time of the next event, and what
            `cosim_step.EVENTS` else points to, or None.

    Raises:
        InputRefused: it cannot be loaded, instantiated or initialised.
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
        self._pending_messages: list[tuple[int, str]] = []
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
        return int(self.fmu.component)

    def address(self, function: str) -> int:
        """Of one of its FMI functions, without prefix: `DoStep`."""
        function = self.description.exported_name(function)
        return ctypes.cast(getattr(self.fmu.dll, function), c_void_p).value or 0

    def takes_ramp(self, variable: Variable) -> bool:
        """Whether it takes an input as a line over a step, and is given such."""
        abilities = self.description.model.coSimulation
        if not self.setup.ramped or variable.causality != "input" or variable.variability != "continuous":
            return False
        if self.description.version < 3:
            return abilities.canInterpolateInputs and variable.type == "Real"
        return abilities.providesIntermediateUpdate and variable.intermediate and variable.type == "Float64"

    def clock_bits(self, variable: Variable) -> int:
        """The clocks with which alone `variable` changes, a bit for each."""
        return sum(1 << n for n, reference in enumerate(self.clocks["reference"]) if reference in variable.clocks)

    def clock_name(self, index: int) -> str:
        """Of a clock of `clocks`."""
        return next((clock.name for clock in clocks(self.description)[index : index + 1]), "?")

    @property
    def schedule(self) -> list[np.ndarray]:
        """What steps change beside its own state: when events and clocks are due."""
        return [self.clocks, self.planned]

    @property
    def invalid_status(self) -> int:
        """Last status outside the standard that a function returned in a step."""
        return int(self.note["status"].astype(np.int32)[0])

    def values(self, variable: Variable) -> list[Any]:
        """Values of `variable`, an array laid out flat, in its own unit and exact.

        Raises:
            ComponentFailed: the FMU does not return them.
        """
        with self.calling("Get"), self._variable_errors(variable):
            return list(self.standard.values(self.fmu, variable))

    def read_floats(self, variables: Sequence[Variable]) -> np.ndarray:
        """Values of `variables`, arrays laid out flat, in the FMU's own units.

        Raises:
            ComponentFailed: the FMU does not return them, or they are beyond `MAX_EXACT`.
        """
        found = [(v, value) for v in variables for value in self.values(v)]
        for v, value in found:
            if isinstance(value, int) and abs(value) > MAX_EXACT:
                raise ComponentFailed(f"{self.label} {inexact_phrase(v.name, v.type, value)}{self.start_phrase}")
        return np.array([value for _, value in found], dtype=float)

    def write(self, settings: Sequence[Setting]) -> None:
        """Set variables; the FMU decides whether it may be done now.

        Raises:
            ComponentFailed: it refuses, or a value does not fit into its type.
        """
        with self.calling("Set"):
            for variable, value in settings:
                with self._variable_errors(variable):
                    self._set_variable(variable, value)

    @property
    def label(self) -> str:
        """File and name of the FMU, the beginning of its error messages."""
        return f"{self.description.path.name} ({self.name})"

    @contextmanager
    def _variable_errors(self, variable: Variable) -> Iterator[None]:
        """Turn every exception in the block, raised for a value of `variable`, into a failure of this component."""
        try:
            yield
        except UnfitValue as problem:
            raise ComponentFailed(f"{self.label} gets {problem}{self.start_phrase}") from None
        # FMPy's FMICallException, or an exception of ctypes for an argument
        except Exception as problem:
            text = f"{problem} for {variable.name}{self.start_phrase}"
            raise ComponentFailed(f"{self.label} {text}{self._quoted_messages()}") from None

    def advance(self, t: float, h: float) -> None:
        """One step from `t` to `t` + `h` (s), after which a saved state may be restored.

        Raises:
            ComponentFailed: it returned more than a warning.
        """
        raise NotImplementedError

    def begin(self) -> None:
        """From initialisation mode, in which it was `waiting`, to step mode.

        Raises:
            InputRefused: it cannot be initialised.
        """
        self._enter_mode(self.standard.leave)

    def reset(self) -> None:
        """FMI's reset, then initialised as the first time.

        Raises:
            ComponentFailed: it refuses. InputRefused: it cannot be initialised again.
        """
        self._call("Reset", self.fmu.reset)
        self._initialise()

    def save_state(self) -> Any:
        """Its state now, a pointer that `free_state` frees.

        Raises:
            ComponentFailed: it refuses.
        """
        return self._call("GetFMUstate", self.fmu.getFMUState)

    def restore_state(self, state: Any) -> None:
        """Go back to `state`, which stays.

        Raises:
            ComponentFailed: it refuses.
        """
        self._call("SetFMUstate", lambda: self.fmu.setFMUState(state))

    def serialize_state(self, state: Any) -> bytes:
        """`state` as bytes.

        Raises:
            ComponentFailed: it refuses.
        """
        return self._call("SerializeFMUstate", lambda: self.fmu.serializeFMUState(state))

    def deserialize_state(self, content: bytes) -> Any:
        """A state, made of what `serialize_state` gave in this process or another one.

        Raises:
            ComponentFailed: it refuses.
        """
        return self._call("DeSerializeFMUstate", lambda: self.fmu.deserializeFMUState(content))

    def free_state(self, state: int) -> None:
        """Free the state at address `state`.

        Raises:
            ComponentFailed: the FMU does not.
        """
        self._call("FreeFMUstate", lambda: self.fmu.freeFMUState(c_void_p(state)))

    def message_state(self) -> list[Any]:
        """What it remembers of messages: those that were handed on, and those that were not yet."""
        return [self.messages, self._pending_messages]

    def restore_messages(self, state: Any) -> None:
        """Go on from what `message_state` returned."""
        self.messages, self._pending_messages = list(state[0]), [(int(tick), str(text)) for tick, text in state[1]]

    def pop_messages(self) -> list[tuple[int, str]]:
        """(tick, text) of what it logged since this was last asked, at most `MAX_PENDING_MESSAGES` of them."""
        # steps are not announced one by one
        self.return_to(self._here)
        messages, self._pending_messages = self._pending_messages, []
        return messages

    def close(self) -> None:
        """Free it; safe to call twice."""
        if self.fmu is not None and self.fmu.component:
            self.standard.free(self)
        self.fmu = None

    @contextmanager
    def calling(self, function: str) -> Iterator[None]:
        """Announce a call of a function of the standard, and restore the working directory after it."""
        here = working_directory()
        try:
            with groups.announce_call(self.description.path.name, self.name, f"{self.description.prefix}{function}"):
                yield
        finally:
            self.return_to(here)

    def return_to(self, folder: str) -> None:
        """Make `folder` the working directory again if the FMU has changed it; a message reports that once."""
        if folder and working_directory() != folder:
            os.chdir(folder)
            if not self._moved:
                self._moved = True
                self.report("changed the working directory; it is back where it was")

    @property
    def start_phrase(self) -> str:
        """When a call fails that is not part of a step."""
        return "" if self.stepped else " at the start"

    def _load_binary(self) -> Any:
        description, here = self.description, working_directory()
        try:
            with groups.announce_call(description.path.name, self.name, "the loading of its binary"):
                return self.standard.load_binary(self)
        # FMPy raises bare Exception for a library that does not load or lacks a function, ctypes AttributeError
        except Exception as problem:
            raise InputRefused(f"{description.path}: its binary does not load: {problem}") from None
        # FMPy goes to the library's folder to load it, and stays there if that fails
        finally:
            os.chdir(here)

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
        # FMPy's FMICallException and whatever is below it: this FMU cannot be used
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
        # FMPy's FMICallException, or ctypes where the binary lacks the function
        except Exception as problem:
            name = f"{self.description.prefix}{function}"
            raise ComponentFailed(
                f"{self.description.path.name}: {name} failed: {problem}{self._quoted_messages()}"
            ) from None

    def _quoted_messages(self) -> str:
        return f" (it said: {'; '.join(self.messages)})" if self.messages else ""

    def on_message(self, status: int, message: bytes | None) -> None:
        """Keep what it logged, if it is a warning or worse."""
        if status > 0 and message:
            text = REFERENCE_PATTERN.sub(self._variable_name, message.decode(errors="replace")).strip()
            # a repeated message is handed on once
            if text in self.messages:
                self.messages.remove(text)
            del self.messages[:-2]
            self.messages.append(text)
            self.report(text)

    def report(self, text: str) -> None:
        """Add a message of its own to those that the FMU logged."""
        if len(self._pending_messages) < MAX_PENDING_MESSAGES:
            self._pending_messages.append((int(self.clock[0]), text))

    def _variable_name(self, reference: re.Match[str]) -> str:
        """Return the variable's name for a reference `#r12#` of a log message (FMI 2.0.4, 2.1.5), else its text."""
        if reference[0] == "##":
            return "#"
        types = LOGGED_TYPES[reference["type"]]
        return next(
            (
                v.name
                for v in self.description.variables.values()
                if v.reference == int(reference["reference"]) and v.type in types
            ),
            reference[0],
        )


class UnfitValue(ValueError):
    """A value that the type of a variable cannot hold."""


def inexact_phrase(name: str, type_name: str, value: int) -> str:
    """Return the verb phrase for a whole number that no signal can hold."""
    return f"returned {value} for {name} ({type_name}), beyond the whole numbers that signals hold exactly (2^53)"
