"""What an FMU is told before it runs."""

from typing import NamedTuple


class Setup(NamedTuple):
    """What an FMU is told of the run before it is initialised.

    Attributes:
        tolerance: relative, of its solver; None: nothing is said.
        stop: time of the last step's end (s); None: nothing is said, and some FMUs then end where they like to.
        step: length of its steps (s), in which its clocks tick; None: not known, and clocks are refused.
        ramped: whether those of its inputs that can be are given as lines over a step.
        waiting: whether it is left in initialisation mode, where what others come to can still be set, until `begin`.
    """

    tolerance: float | None = None
    stop: float | None = None
    step: float | None = None
    ramped: bool = False
    waiting: bool = False
