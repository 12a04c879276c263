"""What of an experiment may be changed while it runs, and where the controller keeps it.

A change is a number written into the controller's record between two ticks. Nothing jumps but what has to: the
integral of a loop is kept in units of its output (`controller/pid.py`), so a new ki acts on errors to come only; a new
kp moves the output by the error times its change; a new reference is a step of the reference.
"""

from dataclasses import dataclass
from typing import NamedTuple

import numpy as np

from twin.controller.controller import Controller
from twin.controller.task_controller import TaskController
from twin.cosim.system import Change, System
from twin.experiment.change import changeable
from twin.experiment.experiment import Experiment


class Place(NamedTuple):
    """Part and field of the controller's record."""

    part: str
    field: str


PLACES = {
    "controller.force.reference_N": Place("law", "F_z_ref"),
    "controller.force.kp_mm_per_N": Place("force", "kp"),
    "controller.force.ki_mm_per_N_s": Place("force", "ki"),
    "controller.position.kp_per_s": Place("position", "kp"),
}
"""By the keys of the experiment's file, those of `twin.experiment.change.CHANGEABLE`."""


@dataclass(frozen=True)
class Tunable:
    """A number of a controller that may be changed between two ticks.

    Attributes:
        key: in the experiment's file, with table and unit. number: what the file says, in that unit.
        memory: where the controller keeps it, SI; one number, or the same for x, y and z.
    """

    key: str
    number: float
    memory: np.ndarray


def tunables(experiment: Experiment, system: System) -> dict[str, Tunable]:
    """What may be changed in `system`, which was assembled of `experiment`, by key.

    Nothing of a controller that is not ours.
    """
    controller = system.component("controller")
    if not isinstance(controller, Controller | TaskController):
        return {}
    return {
        key: Tunable(key, number, controller.memory[PLACES[key].part][PLACES[key].field])
        for key, number in changeable(experiment.values).items()
    }


def scheduled(experiment: Experiment, system: System) -> tuple[Change, ...]:
    """The experiment's own changes, for `system`, which was assembled of it."""
    found = tunables(experiment, system)
    return tuple(Change(c.tick, found[c.key].memory, c.value) for c in experiment.changes if c.key in found)
