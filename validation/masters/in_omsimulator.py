"""OMSimulator, by the C interface of its library.

OMSimulator's Python package fetches that library from a server of its own when it is installed. One that somebody has
built is named in the environment.
"""

import ctypes
import os
import tempfile
from collections.abc import Iterator
from contextlib import contextmanager
from functools import cache

import numpy as np
from numpy.typing import NDArray

from validation.masters.wired import Wired
from validation.yardstick import NotHere

LIBRARY = "OMSIMULATOR_LIBRARY"
"""Environment variable: the path of libOMSimulator.so."""
WEAKLY_COUPLED, STRONGLY_COUPLED = 1, 2
"""Kinds of systems: FMUs for co-simulation, FMUs for model exchange solved as one."""
LEAST_STEP = 1e-12
MODEL = "wired"
SYSTEM = f"{MODEL}.root"


class Library:
    """OMSimulator's functions; it is loaded once, and says what goes wrong.

    Raises:
        NotHere: its library is not named in the environment, or does not load.
    """

    def __init__(self) -> None:
        where = os.environ.get(LIBRARY)
        if not where:
            raise NotHere(f"libOMSimulator.so is not installed; build it, and make validation {LIBRARY}=its_path")
        try:
            self._functions = ctypes.CDLL(where)
        except OSError as missing:
            raise NotHere(f"{LIBRARY} does not load: {str(missing).rpartition('/')[2]}") from None
        self._said = "nothing is said of it"
        self._hearing = ctypes.CFUNCTYPE(None, ctypes.c_int, ctypes.c_char_p)(self._hear)
        self._functions.oms_setLoggingCallback(self._hearing)
        # otherwise among the lines of a table
        self.call("oms_setLogFile", os.devnull)

    def _hear(self, _: int, message: bytes) -> None:
        self._said = message.decode()

    def call(self, name: str, *arguments: object) -> None:
        """A function; texts and floats in the types of C.

        Raises:
            RuntimeError: it does not return success.
        """
        given = [
            a.encode() if isinstance(a, str) else ctypes.c_double(a) if isinstance(a, float) else a for a in arguments
        ]
        if self._functions[name](*given):
            raise RuntimeError(f"{name} fails for {arguments}: {self._said}")

    def step(self) -> None:
        """One step of the model that is open."""
        self.call("oms_doStep", MODEL)


library = cache(Library)


@contextmanager
def initialised(given: Wired, kind: int = WEAKLY_COUPLED, tolerance: float = 0.0) -> Iterator[Library]:
    """OMSimulator with a model, before its first step.

    Args:
        given: FMUs and wires.
        kind: of the system.
        tolerance: of its solver, relative and absolute; 0: its own.

    Raises:
        NotHere: its library is not here.
        RuntimeError: it refuses or fails.
    """
    oms = library()
    with tempfile.TemporaryDirectory() as folder:
        oms.call("oms_setTempDirectory", folder)
        oms.call("oms_newModel", MODEL)
        try:
            oms.call("oms_addSystem", SYSTEM, kind)
            for name, file in given.parts.items():
                oms.call("oms_addSubModel", f"{SYSTEM}.{name}", str(file))
            for variable, value in given.settings.items():
                oms.call("oms_setReal", f"{SYSTEM}.{variable}", value)
            for name in () if given.units else {end for wire in given.wires for end in wire}:
                oms.call("oms_setUnit", f"{SYSTEM}.{name}", "1")
            for start, end in given.wires:
                oms.call("oms_addConnection", f"{SYSTEM}.{start}", f"{SYSTEM}.{end}", not given.units)
            if tolerance:
                oms.call("oms_setTolerance", SYSTEM, tolerance)
            if kind == WEAKLY_COUPLED:
                oms.call("oms_setFixedStepSize", SYSTEM, given.tick)
            else:
                # a solver's: the first, the least, and that from one value to the next
                oms.call("oms_setVariableStepSize", SYSTEM, LEAST_STEP, LEAST_STEP, given.tick)
            # later than the end: the last step would be cut to it
            oms.call("oms_setStopTime", MODEL, (given.ticks + 2) * given.tick)
            oms.call("oms_setResultFile", MODEL, "", 1)
            oms.call("oms_instantiate", MODEL)
            oms.call("oms_initialize", MODEL)
            yield oms
            oms.call("oms_terminate", MODEL)
        finally:
            oms.call("oms_delete", MODEL)


def values(given: Wired, every: int = 1, kind: int = WEAKLY_COUPLED, tolerance: float = 0.0) -> NDArray[np.float64]:
    """The seen outputs every so many ticks, from the start on; (rows, outputs); raises as `initialised`."""
    rows, found = np.empty((given.ticks // every + 1, len(given.seen))), ctypes.c_double()
    with initialised(given, kind, tolerance) as oms:
        for k in range(given.ticks + 1):
            if k % every == 0:
                for i, name in enumerate(given.seen):
                    oms.call("oms_getReal", f"{SYSTEM}.{name}", ctypes.byref(found))
                    rows[k // every, i] = found.value
            if k < given.ticks:
                oms.step()
    return rows
