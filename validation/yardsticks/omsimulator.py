"""The robot in OMSimulator, by the C interface of its library.

OMSimulator's Python package fetches that library from a server of its own when it is installed. One that somebody has
built is named in the environment.
"""

import ctypes
import os
from itertools import accumulate, repeat

from validation.masters.master import (
    FIG4,
    MASSAGE,
    Master,
    beside_a_loop,
    beside_the_twin,
)
from validation.masters.robot import Robot, Rows, Signals
from validation.yardstick import NotHere

LIBRARY = "OMSIMULATOR_LIBRARY"
"""Environment variable: the path of libOMSimulator.so."""
WEAKLY_COUPLED = 1
MODEL, SYSTEM = "robot", "robot.root"


class Library:
    """OMSimulator's functions.

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

    def call(self, name: str, *arguments: object) -> None:
        """A function; texts and floats in the types of C.

        Raises:
            RuntimeError: it does not return success.
        """
        given = [
            a.encode() if isinstance(a, str) else ctypes.c_double(a) if isinstance(a, float) else a for a in arguments
        ]
        if self._functions[name](*given):
            raise RuntimeError(f"{name} fails for {arguments}")


def run(given: Robot) -> Signals:
    """What OMSimulator gives.

    Raises:
        NotHere: its library is not here.
        RuntimeError: it refuses or fails.
    """
    oms = Library()
    oms.call("oms_setTempDirectory", str(given.folder / "omsimulator"))
    oms.call("oms_newModel", MODEL)
    oms.call("oms_addSystem", SYSTEM, WEAKLY_COUPLED)
    for name, file in given.files.items():
        oms.call("oms_addSubModel", f"{SYSTEM}.{name}", str(file))
        for variable, value in given.parameters.get(name, {}).items():
            oms.call("oms_setReal", f"{SYSTEM}.{name}.{variable}", value)
    for wire in given.wires:
        source, target = (f"{SYSTEM}.{'.'.join(end)}" for end in (wire.source, wire.target))
        oms.call("oms_addConnection", source, target, False)
    oms.call("oms_setFixedStepSize", SYSTEM, given.own.tick)
    # later than the end: the last step would be cut to it
    oms.call("oms_setStopTime", MODEL, (given.ticks + 2) * given.own.tick)
    oms.call("oms_setResultFile", MODEL, "", 1)
    oms.call("oms_instantiate", MODEL)
    oms.call("oms_initialize", MODEL)
    rows, found = Rows(given), ctypes.c_double()
    seen = [
        (rows.values[name], [f"{SYSTEM}.{name}.{output}" for output in given.outputs[name]]) for name in given.files
    ]
    for k in range(given.ticks):
        oms.call("oms_doStep", MODEL)
        for values, names in seen:
            for i, name in enumerate(names):
                oms.call("oms_getReal", name, ctypes.byref(found))
                values[k + 1, i] = found.value
    oms.call("oms_terminate", MODEL)
    oms.call("oms_delete", MODEL)
    return rows.signals()


TIMES = tuple(accumulate(repeat(0.001, 62_000), initial=0.0))
"""As OMSimulator has them: one step after another added up (s)."""
OMSIMULATOR = Master(
    run, "OMSimulator 3.0, Open Source Modelica Consortium, built from its sources", starts_inside=True
)
SUMS = (
    "OMSimulator adds up time and hands on the difference of two sums, which after 20 s is off by 1e-12 of a step; its "
    "wires add nothing, so that the drives count from the angles where they begin"
)
SUMMED = 1e-10
WHY_SUMMED = "for long in the same direction, so that it comes to more"
YARDSTICKS = (
    beside_the_twin(OMSIMULATOR, FIG4, SUMMED, f"{SUMS}; {WHY_SUMMED}"),
    beside_a_loop(OMSIMULATOR, FIG4, TIMES.__getitem__, "adds up time"),
    beside_the_twin(OMSIMULATOR, MASSAGE, SUMMED, f"{SUMS}; {WHY_SUMMED}"),
    beside_a_loop(OMSIMULATOR, MASSAGE, TIMES.__getitem__, "adds up time"),
)
