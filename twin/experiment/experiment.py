"""The validated experiment, SI inside."""

from dataclasses import dataclass, field
from typing import Any

from pydantic import Field

from twin.experiment import schema, task
from twin.experiment.change import Change
from twin.experiment.contact import Contact
from twin.experiment.fault import Fault
from twin.experiment.measure import Measure
from twin.experiment.monitor import Monitor
from twin.experiment.quantity import Section, quantity
from twin.experiment.reference import Reference, WayPoints
from twin.experiment.robot import Plant, Robot, Triple
from twin.experiment.stand_in import StandIn


class Head(Section):
    """The keys of an experiment that stand in no table."""

    title: str = Field(min_length=1, description="for people")
    duration: float = quantity("duration_s", "simulated time", gt=0)
    seed: int = Field(0, ge=0, lt=2**63, description="seed of the encoders' noise")


TABLES: dict[str, type[Section]] = {
    "robot": Robot,
    "plant": Plant,
    "contact": Contact,
    "cosim": schema.Cosim,
    "controller": schema.Controller,
}
OPTIONAL_TABLES: dict[str, type[Section]] = {
    "scale": schema.Scale,
    "reference": Reference,
    "approach": task.Approach,
    "monitor": Monitor,
    "recording": schema.Recording,
    "estimator": StandIn,
    "body": StandIn,
}
ARRAYS = ("task", "fault", "change", "measure")
"""Arrays of tables."""


@dataclass(frozen=True)
class Experiment:
    """Everything a run needs, checked, SI.

    Attributes:
        name: the file's stem.
        title: for people.
        seed: of the encoders' noise.
        duration_ticks, controller_ticks, scale_ticks, monitor_ticks: durations and periods in ticks.
        reference: way points, those of a shape too; None: `tasks` lead the robot, and `approach` says how they come and
            go.
        scale: the display; None: what the robot presses on has none.
        monitor: None: nobody watches.
        faults: what breaks, in ticks.
        changes: what of the controller changes on the way, in ticks.
        measures: what `twin check` measures.
        drives: one per joint, complete, FMUs as absolute paths.
        recording: what of the run is kept.
        values: the merged file as it was checked, keys with units.
        origins: where each value comes from.
        stand_ins: parts of another make by the name of their table; of [controller], [monitor] and [scale] only what
            acts all the same is in their own.
    The tables are those of `schema.py`, `contact.py`, `task.py` and `monitor.py`.
    """

    name: str
    title: str
    seed: int
    duration_ticks: int
    controller_ticks: int
    scale_ticks: int
    monitor_ticks: int
    robot: Robot
    plant: Plant
    contact: Contact
    scale: schema.Scale | None
    cosim: schema.Cosim
    controller: schema.Controller
    reference: WayPoints | None
    approach: task.Approach | None
    tasks: tuple[task.Task, ...]
    monitor: Monitor | None
    faults: tuple[Fault, ...]
    changes: tuple[Change, ...]
    measures: tuple[Measure, ...]
    drives: tuple[schema.Drive, schema.Drive, schema.Drive]
    recording: schema.Recording
    values: dict[str, Any]
    origins: dict[str, str]
    stand_ins: dict[str, StandIn] = field(default_factory=dict)

    @property
    def start(self) -> Triple:
        """Where the platform rests at the beginning (m)."""
        if self.reference is not None:
            return self.reference.p[0]
        assert self.approach is not None
        return (*self.tasks[0].point, self.approach.height)
