"""Inputs between communication points: held constant, or interpolated linearly.

A component takes its inputs as constants over a step. A value held from one end of the step makes an error of first
order in the step size; the value in the middle makes one of second order (the midpoint rule). Both ends are known for
a source that steps earlier in Gauss-Seidel order, and for any source in a repeated step; otherwise the line of the
previous step is extrapolated (Kuebler and Schiehlen 2000; FMI 3.0, 4.2.1).
"""

from typing import Literal

import numpy as np

from twin.kernel.cosim.port import Port

Inputs = Literal["hold", "linear"]
Scheme = Literal["gauss_seidel", "jacobi"]

VALID_WEIGHTS, NEWEST_WEIGHTS, PREVIOUS_WEIGHTS = np.eye(3)
"""Unit weights of the output valid at the step's start, the newest result, and the output valid one step before."""


def input_weights(port: Port, seen: bool, inputs: Inputs) -> np.ndarray:
    """Weights (2, 3) of the source's valid, newest (if `seen`) and previous outputs in an input: first, later steps."""
    ends = np.array(
        [
            NEWEST_WEIGHTS if seen else VALID_WEIGHTS if inputs == "hold" else 2.0 * VALID_WEIGHTS - PREVIOUS_WEIGHTS,
            NEWEST_WEIGHTS,
        ]
    )
    if inputs == "hold" or port.instant == "end":
        return ends
    return np.array([VALID_WEIGHTS, VALID_WEIGHTS]) if port.instant == "start" else 0.5 * (VALID_WEIGHTS + ends)
