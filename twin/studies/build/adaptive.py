"""Where a controller keeps what it does besides the paper's law: tissue, schedule, breath, taps that learn."""

from collections.abc import Iterator
from typing import Any

import numpy as np

from twin.experiment.schema import Controller
from twin.runs.assembly.adapting import DOUBTFUL, ENOUGH
from twin.studies.build.part import RobotPart


def senses(part: RobotPart) -> bool:
    """Whether its controller senses the tissue: masses and springs are worked out of its model then, in Python."""
    return part.component("controller") is not None and part.experiment.controller.tissue is not None


def besides(computer: Controller, memory: Any) -> Iterator[tuple[str, np.ndarray, float]]:
    """(key, where it is, memory over SI value) of each number; `memory`: of the adaptive part of the controller."""
    tissue, schedule, breath, touch = memory["tissue"], memory["schedule"], memory["breath"], computer.touch
    for name in ("frequency", "window", "dither"):
        yield f"controller.tissue.{name}", tissue[name], 1.0
    yield "controller.tissue.tolerance", tissue["enough"], ENOUGH
    yield "controller.tissue.tolerance", tissue["doubtful"], DOUBTFUL
    if computer.force.schedule:
        yield "controller.tissue.tolerance", schedule["tolerance"], 1.0
        # kp and ki: the safe set
        for name in ("follow", "rate", "kp", "ki"):
            yield f"controller.force.{name}", schedule[name], 1.0
    if computer.breath is not None:
        for name in ("rate", "lag"):
            yield f"controller.breath.{name}", breath[name], 1.0
    if touch is not None and touch.force_learning > 0.0:
        yield "controller.touch.force_learning", memory["taps"]["share"], 1.0
