"""Input signals between communication points: held, or interpolated linearly.

A component takes its inputs as constants over a step. Held values that belong to one end of it make an error of order
one in the step; the value of the middle makes one of order two, because what rises by as much after the middle as
before it cancels (the midpoint rule). Of a source that goes before in Gauss-Seidel order, or in a repeated step of any,
both ends of the line are known; else the line of the step before is drawn on (Kuebler and Schiehlen 2000; FMI 3.0,
4.2.1).
"""

from typing import Literal

import numpy as np

from twin.kernel.cosim.port import Port

Inputs = Literal["hold", "linear"]
Scheme = Literal["gauss_seidel", "jacobi"]

VALID, NEWEST, BEFORE = np.eye(3)
"""What is valid at the start of the step, the newest result, and what was valid one step earlier."""


def input_weights(port: Port, seen: bool, inputs: Inputs) -> np.ndarray:
    """Weights (2, 3) of `VALID`, `NEWEST` and `BEFORE` in the first step of a tick and in a repeated one.

    Args:
        port: the input.
        seen: whether its source's result is known in the first step.
    """
    ends = np.array([NEWEST if seen else VALID if inputs == "hold" else 2.0 * VALID - BEFORE, NEWEST])
    if inputs == "hold" or port.instant == "end":
        return ends
    return np.array([VALID, VALID]) if port.instant == "start" else 0.5 * (VALID + ends)
