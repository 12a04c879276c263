"""A drive that cannot run as fast as it is told: the command is limited on its last way into the drive."""

import numpy as np
from numba import carray

from twin.cosim.component import NativeComponent
from twin.cosim.native import step_function
from twin.cosim.port import Port
from twin.faults.fault import Fault
from twin.faults.window import ACTIVE, WINDOW, tick_now, window, within

KINDS = ("drive_saturation", "brown_out")

MEMORY = np.dtype([("window", WINDOW), ("size", "i8"), ("limit", "f8")], align=True)


@step_function(MEMORY)
def step(m, t, h, u, y):
    asked, given = carray(u, m.size), carray(y, m.size + 1)
    active = within(m.window, tick_now(m.window))
    for j in range(m.size):
        given[j] = min(max(asked[j], -m.limit), m.limit) if active else asked[j]
    given[m.size] = active
    return 0


class CommandFault(NativeComponent):
    """Sampled component, every tick: commanded speeds in, the same within +-limit out while active.

    Args:
        name: of the component.
        fault: its magnitude is the limit (rad/s), of a brown-out the share of `speed_limit` that the sagging supply
            leaves: without load a motor's highest speed is proportional to its voltage.
        size: number of drives behind it.
        speed_limit: what a healthy drive can run (rad/s).
    """

    def __init__(self, name: str, fault: Fault, size: int, speed_limit: float):
        port = Port("omega_ref", size, "rad/s", "commanded motor speed, as far as the drive can follow")
        memory = np.zeros(1, dtype=MEMORY)
        memory["window"][0] = window(fault, 1)
        memory["size"] = size
        memory["limit"] = fault.magnitude * (speed_limit if fault.kind == "brown_out" else 1.0)
        super().__init__(name, (port,), (port, ACTIVE), True, step, memory)
