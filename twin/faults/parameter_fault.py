"""A constant of another component that changes while the robot runs."""

from dataclasses import dataclass, replace
from typing import Literal

import numpy as np
from numba import carray

from twin.cosim.component import Component, NativeComponent
from twin.cosim.native import doubles_at, step_function
from twin.cosim.place import Place
from twin.cosim.port import Port
from twin.errors import InputRefused
from twin.faults.fault import Fault
from twin.faults.window import ACTIVE, WINDOW, tick_now, window, within

Operation = Literal["factor", "added"]


@dataclass(frozen=True)
class Parameter(Place):
    """Where a kind's parameter lies, and how the magnitude acts on it."""

    operation: Operation


PARAMETERS = {
    "spring_softened": Parameter("plant", "parameters", "k_s_share", "factor"),
    "spring_broken": Parameter("plant", "parameters", "k_s_share", "factor"),
    "stiffness_change": Parameter("plant", "parameters", "K", "factor"),
    "backlash_growth": Parameter("plant", "parameters", "backlash_added", "added"),
    "joint_friction": Parameter("plant", "parameters", "b_j_added", "added"),
    "belt_slip": Parameter("plant", "parameters", "slip", "added"),
    "belief_k_s": Parameter("estimator", "belief", "k_s", "factor"),
    "belief_eta": Parameter("estimator", "belief", "eta", "factor"),
}

VALUE = Port("value", 1, "SI", "the parameter as it holds now")
MEMORY = np.dtype(
    [
        ("window", WINDOW),
        ("address", "i8"),
        ("nominal", "f8"),
        ("chained", "i8"),
        ("factor", "f8"),
        ("added", "f8"),
        ("ramp", "i8"),
    ],
    align=True,
)
"""`chained`: another fault writes to the same address before; what it wrote is this one's nominal value."""


@step_function(MEMORY, outputs=(VALUE, ACTIVE))
def step(m, t, h, u, y):
    parameter = carray(doubles_at(m.address), 1)
    k = tick_now(m.window)
    active = within(m.window, k)
    value = parameter[0] if m.chained else m.nominal
    if active:
        grown = min(1.0, (k - m.window.onset) / m.ramp) if m.ramp else 1.0
        value = value * (1.0 + grown * (m.factor - 1.0)) + grown * m.added
    parameter[0] = value
    y.value, y.active = value, active
    return 0


class ParameterFault(NativeComponent):
    """Sampled component, first in every tick: writes the value that holds from now on.

    Before the onset and after the end that is the nominal value, to the last bit.

    Args:
        name: of the component. number: of the fault in its file, from 1.
        fault: its magnitude is a factor on the parameter or an addition to it (SI), as `PARAMETERS` says.
        owner: the component whose memory holds the parameter.
        element: which element of the field; 0 where it is a single number.
        chained: whether a fault before it in the tick writes to the same place.

    Raises:
        InputRefused: `owner` has no such parameter.
    """

    def __init__(self, name: str, number: int, fault: Fault, owner: Component, element: int, chained: bool):
        cell = parameter_cell(number, fault, owner, element)
        memory = np.zeros(1, dtype=MEMORY)
        memory["window"][0] = window(fault, 1)
        m = memory[0]
        m["address"], m["nominal"], m["chained"], m["ramp"] = cell.ctypes.data, cell[0], chained, fault.ramp
        is_factor = PARAMETERS[fault.kind].operation == "factor"
        m["factor"], m["added"] = (fault.magnitude, 0.0) if is_factor else (1.0, fault.magnitude)
        value = replace(VALUE, meaning=f"{PARAMETERS[fault.kind].field} of {owner.name}, as it holds now")
        super().__init__(name, (), (value, ACTIVE), True, step, memory, keep=owner)


def parameter_cell(number: int, fault: Fault, owner: Component, element: int) -> np.ndarray:
    """The parameter itself in the memory of `owner`, (1,) float64, a view.

    Raises:
        InputRefused: it has no such parameter.
    """
    place = PARAMETERS[fault.kind]
    field = place.memory_of(owner)
    if field is None:
        raise InputRefused(
            f"[[fault]] {number}: {fault.kind} writes {place.record}.{place.field} in the memory of component "
            f"'{owner.name}', which has none; remove the fault or use the native {owner.name}"
        )
    return field[0, element : element + 1] if field.ndim == 2 else field[0:1]
