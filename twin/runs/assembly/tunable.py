"""What of an experiment may be changed while it runs, and where the controller keeps it.

A change is a number written into the controller's record between two ticks. Nothing jumps but what has to: the
integral of a loop is kept in units of its output (`controller/pid.py`), so a new ki acts on errors to come only; a new
kp moves the output by the error times its change; a new reference is a step of the reference.
"""

from typing import NamedTuple

import numpy as np

from twin.cosim.system import MemoryChange, System
from twin.experiment.change import changeable
from twin.experiment.experiment import Experiment
from twin.runs.assembly.declared import DECLARED, PLACES

FORCE_REFERENCE = "controller.force.reference_N"


class Tunable(NamedTuple):
    """A number that may be changed between two ticks.

    Attributes:
        number: what the experiment's file says, in the unit of its key.
        memory: where its component keeps it, SI; one number, or the same for x, y and z.
    """

    number: float
    memory: np.ndarray


def tunables(experiment: Experiment, system: System) -> dict[str, Tunable]:
    """What may be changed in `system`, which was assembled of `experiment`, by its key in the experiment's file.

    Nothing of a controller that keeps it elsewhere than ours.
    """
    found = {}
    for key, number in changeable(DECLARED, experiment.values).items():
        memory = PLACES[key].memory_of(system.component(PLACES[key].component))
        if memory is not None:
            found[key] = Tunable(number, memory)
    return found


def scheduled(experiment: Experiment, system: System) -> tuple[MemoryChange, ...]:
    """The experiment's own changes, for `system`, which was assembled of it."""
    found = tunables(experiment, system)
    return tuple(MemoryChange(c.tick, found[c.key].memory, c.value) for c in experiment.changes if c.key in found)
