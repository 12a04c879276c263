"""A constant of another component that changes while the robot runs."""

from dataclasses import replace

import numpy as np

from twin.compiled.function import carray
from twin.cosim.component import Component
from twin.cosim.native import doubles_at, step_function
from twin.cosim.port import Port, memory_of, record
from twin.faults.command_fault import ACTIVE, WINDOW, FaultComponent, Span, tick_now, window, within

VALUE = Port("value", 1, "SI", "the parameter as it holds now")
MEMORY = record(window=WINDOW, address="i8", nominal="f8", chained="i8", factor="f8", added="f8", ramp="i8")
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


class ParameterFault(FaultComponent):
    """Sampled component, first in every tick: writes the value that holds from now on.

    Before the onset and after the end that is the nominal value, to the last bit.

    Args:
        name: of the component.
        span: when it is active.
        owner: the component in whose memory the parameter lies.
        parameter: what it is called there.
        cell: the parameter itself, a view (1,) of that memory.
        factor, added: what the nominal value is multiplied by, and what is added to it (SI).
        ramp: ticks in which both grow from nothing; 0: at once.
        chained: whether a fault before it in the tick writes to the same place.
    """

    def __init__(
        self,
        name: str,
        span: Span,
        owner: Component,
        parameter: str,
        cell: np.ndarray,
        factor: float,
        added: float,
        ramp: int,
        chained: bool,
    ):
        memory = memory_of(MEMORY, window=window(span, 1), factor=factor, added=added, ramp=ramp, chained=chained)
        memory["address"], memory["nominal"] = cell.ctypes.data, cell[0]
        value = replace(VALUE, meaning=f"{parameter} of {owner.name}, as it holds now")
        super().__init__(name, (), (value, ACTIVE), True, step, memory, keep=owner)
