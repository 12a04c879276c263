"""The angle of a servo that counts over one turn only, counted on."""

import numpy as np

from twin.cosim.component import NativeComponent
from twin.cosim.native import step_function
from twin.cosim.port import Port
from twin.cosim.record import memory_of, record
from twin.drive.contract import THETA_M

INPUTS = (Port("wrapped", 1, "rad", "motor angle, but for whole turns of the servo"),)
OUTPUTS = (THETA_M.port,)
MEMORY = record(turn="f8", theta="f8")


@step_function(MEMORY, INPUTS, OUTPUTS)
def step(m, t, h, u, y):
    # no shaft turns by half a turn within a step
    m.theta = u.wrapped - m.turn * round((u.wrapped - m.theta) / m.turn)
    y.theta_m = m.theta
    return 0


class Unwrapped(NativeComponent):
    """Continuous component behind the drive's FMU: its angle in, the same without jumps by whole turns out.

    Args:
        turn: of the servo, as an angle of the motor shaft (rad).
        theta_m: angle at t = 0 (rad).
    """

    def __init__(self, turn: float, theta_m: float):
        memory = memory_of(MEMORY, turn=turn, theta=theta_m)
        super().__init__("unwrapped", INPUTS, OUTPUTS, False, step, memory, np.array([theta_m]))
