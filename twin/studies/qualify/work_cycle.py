"""The run on which most findings stand: rest, a step of the command, a step of the load."""

import numpy as np

from twin.studies.metrics.response import Curve
from twin.studies.qualify.operating_range import LOAD_IN_USE, SPEED_IN_USE, TICK

COMMANDED = 0.2
"""When the command steps (s)."""
LOADED = 2.2
"""When the load steps (s); slow drives have settled by then."""
END = 4.2
"""s."""
AVERAGE = 1.0
"""How long before the load step, and before the end, speeds are averaged (s)."""


def work_cycle(speed: float = SPEED_IN_USE, load: float = LOAD_IN_USE, end: float = END) -> tuple[Curve, Curve]:
    """Commanded speed (rad/s) and load (N m), one value per tick, (ticks,).

    Args:
        speed, load: after their steps.
        end: s.
    """
    k = np.arange(round(end / TICK))
    return np.where(k >= round(COMMANDED / TICK), speed, 0.0), np.where(k >= round(LOADED / TICK), load, 0.0)
