"""Which solver a model-exchange FMU is given."""

from typing import Literal, NamedTuple

USUAL_TOLERANCE = 1e-6
"""Relative, of CVODE, where neither the experiment nor the FMU says anything."""


class Solver(NamedTuple):
    """What integrates the equations of an FMU.

    Attributes:
        method: "cvode" holds a tolerance, whatever the equations are; "rk4" goes in steps of one length.
        step: longest step of "rk4" (s); None: one per step of the drive.
    """

    method: Literal["cvode", "rk4"] = "cvode"
    step: float | None = None
