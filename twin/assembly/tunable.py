"""What of an experiment may be changed while it runs, and where the controller keeps it.

A change is a number written into the controller's record between two ticks. Nothing jumps but what has to: the
integral of a loop is kept in units of its output (`controller/pid.py`), so a new ki acts on errors to come only; a new
kp moves the output by the error times its change; a new reference is a step of the reference.
"""

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any, NamedTuple

import numpy as np
from pydantic import ValidationError

from twin.controller.controller import Controller
from twin.controller.task_controller import TaskController
from twin.cosim.system import System
from twin.errors import InputRefused
from twin.experiment.experiment import Experiment
from twin.experiment.mistakes import sentences
from twin.experiment.quantity import Section
from twin.experiment.schema import ForceLoop, PositionLoop


class Place(NamedTuple):
    """Table and attribute of the schema, part and field of the controller's record."""

    table: type[Section]
    attribute: str
    part: str
    field: str


PLACES = {
    "controller.force.reference_N": Place(ForceLoop, "reference", "law", "F_z_ref"),
    "controller.force.kp_mm_per_N": Place(ForceLoop, "kp", "force", "kp"),
    "controller.force.ki_mm_per_N_s": Place(ForceLoop, "ki", "force", "ki"),
    "controller.position.kp_per_s": Place(PositionLoop, "kp", "position", "kp"),
}
"""By the keys of the experiment's file. Only their own table has a say in what they may be."""


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

    def in_si(self, number: object, tables: Mapping[str, Any]) -> float:
        """`number`, given in the unit of the key, in SI.

        Args:
            number: whatever somebody has sent. tables: of the experiment, as `Experiment.values`.

        Raises:
            InputRefused: the experiment's schema refuses it.
        """
        if number is None:
            # the file may leave the reference out where no force loop acts; a running one needs it
            raise InputRefused(f"{self.key}: no value; expected a number")
        place = PLACES[self.key]
        *path, key = self.key.split(".")
        for name in path:
            tables = tables[name]
        try:
            table = place.table.model_validate({**tables, key: number})
        except ValidationError as error:
            raise InputRefused("; ".join(sentences(error, place.table, ".".join(path)))) from None
        return getattr(table, place.attribute)


def tunables(experiment: Experiment, system: System) -> dict[str, Tunable]:
    """What may be changed in `system`, which was assembled of `experiment`, by key.

    Nothing of the force loop where it never acts, no reference where tasks bring their own, and nothing of a
    controller that is not ours.
    """
    controller = system.component("controller")
    if not isinstance(controller, Controller | TaskController):
        return {}
    found = {}
    for key, place in PLACES.items():
        _, table, name = key.split(".")
        number = experiment.values["controller"][table].get(name)
        acts = place.table is not ForceLoop or experiment.controller.mode == "force_position"
        if acts and number is not None:
            found[key] = Tunable(key, number, controller.memory[place.part][place.field])
    return found
