"""The validated experiment, SI inside."""

from __future__ import annotations

from dataclasses import dataclass, field
from typing import TYPE_CHECKING, Any

from twin.experiment import schema, task
from twin.experiment.change import Change
from twin.experiment.drive_files import StandIn
from twin.experiment.fault import Fault
from twin.experiment.measure import Measure
from twin.experiment.task import Reference, WayPoints
from twin.settings import Settings, Triple, setting

if TYPE_CHECKING:
    # what the tables of parts are called, for the type checker alone
    from twin.controller.computer import Computer
    from twin.monitor.checks import Monitor
    from twin.plant.contact_law import Contact
    from twin.plant.parameters import Robot, TrueRobot
    from twin.plant.scale import Display


class Head(Settings):
    """The keys of an experiment that stand in no table."""

    title: str = setting(min_length=1, help="for people")
    duration: float = setting("s", gt=0, help="simulated time")
    seed: int = setting(default=0, ge=0, lt=2**63, help="seed of the encoders' noise")


NEEDED: dict[str, type[Settings]] = {"cosim": schema.Cosim}
OPTIONAL: dict[str, type[Settings]] = {
    "reference": Reference,
    "approach": task.Approach,
    "recording": schema.Recording,
    "estimator": StandIn,
    "body": StandIn,
}
"""Tables that are no part's: an experiment needs the first ones."""
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
    The tables are those that the parts declare, and those of `schema.py`, `reference.py` and `task.py`.
    """

    name: str
    title: str
    seed: int
    duration_ticks: int
    controller_ticks: int
    scale_ticks: int
    monitor_ticks: int
    robot: Robot
    plant: TrueRobot
    contact: Contact
    scale: Display | None
    cosim: schema.Cosim
    controller: Computer
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
