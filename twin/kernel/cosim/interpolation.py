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

VALID_WEIGHTS, NEWEST_WEIGHTS, PREVIOUS_WEIGHTS = np.eye(3)
"""What is valid at the start of the step, the newest result, and what was valid one step earlier."""


def input_weights(port: Port, seen: bool, inputs: Inputs) -> np.ndarray:
    """Weights (2, 3) of `VALID_WEIGHTS`, `NEWEST_WEIGHTS` and `PREVIOUS_WEIGHTS` in the first step of a tick and in a repeated one.

    Args:
        port: the input.
        seen: whether its source's result is known in the first step.
    """
    ends = np.array(
        [
            NEWEST_WEIGHTS if seen else VALID_WEIGHTS if inputs == "hold" else 2.0 * VALID_WEIGHTS - PREVIOUS_WEIGHTS,
            NEWEST_WEIGHTS,
        ]
    )
    if inputs == "hold" or port.instant == "end":
        return ends
    return np.array([VALID_WEIGHTS, VALID_WEIGHTS]) if port.instant == "start" else 0.5 * (VALID_WEIGHTS + ends)
