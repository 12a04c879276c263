"""Our velocity loop for drives that take torque, current or voltage: a discrete PI at its own rate."""

import numpy as np
from numba import carray

from twin.controller.pid import PID, Gains, accept, loop, proposal
from twin.cosim.component import NativeComponent, Port
from twin.cosim.native import step_function

INPUTS = (
    Port("omega_ref", 1, "rad/s", "commanded motor speed"),
    Port("omega_m", 1, "rad/s", "motor speed, as the drive reports it"),
)
MEMORY = np.dtype([("pid", PID), ("limit", "f8")], align=True)


@step_function(MEMORY)
def step(self, t, h, u, y):
    m = carray(self, 1)[0]
    speed = carray(u, 2)
    command, integral = proposal(m.pid, speed[0] - speed[1], h)
    if abs(command) <= m.limit:
        accept(m.pid, integral)
    carray(y, 1)[0] = min(max(command, -m.limit), m.limit)
    return 0


class VelocityLoop(NativeComponent):
    """Sampled component: speed error in, command of the drive out.

    Args:
        gains: PI from rad/s to the command's SI unit. limit: of the command, either side.
        command: port of the output.
        period: in ticks of the drive's own system.
    """

    def __init__(self, gains: Gains, limit: float, command: Port, period: int = 1):
        memory = np.zeros(1, dtype=MEMORY)
        memory["pid"][0] = loop(gains)
        memory["limit"] = limit
        super().__init__("velocity_loop", INPUTS, (command,), True, step, memory, period=period)
