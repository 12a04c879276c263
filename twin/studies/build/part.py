"""A part of the robot: its components, what joins them, and what comes in from outside."""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np

from twin.cosim.component import Component, NativeComponent
from twin.cosim.port import Port, by_port, width
from twin.cosim.wiring import End, Feeds
from twin.errors import InputRefused, nearest
from twin.experiment.experiment import Experiment
from twin.plant.beginning import REST_OUTPUTS, outputs_at_start, rest
from twin.plant.component import inputs as plant_inputs
from twin.runs.assembly.assemble import HERE
from twin.runs.assembly.build import Build
from twin.runs.assembly.mechanics import at_rest, motions
from twin.runs.assembly.robot import ROBOT, connected

DRIVE = "drive"
PARTS = {
    "plant": ("body", "scale", "plant"),
    "computer": ("encoder", "estimator", "controller", "delay", "monitor"),
    "controls": ("estimator", "controller", "delay", "monitor"),
}
"""Parts of several components, as far as an experiment has them; any other component is one by its name."""


@dataclass(frozen=True)
class Beginning:
    """A compiled function that is called before the first step, as a step is; it works on its component's memory.

    Attributes:
        step: it.
        outputs: ports of its own; none: it writes those of the component.
    """

    step: Any
    outputs: tuple[Port, ...] = ()


@dataclass(frozen=True)
class RobotPart:
    """What is built.

    Attributes:
        name: of the part.
        experiment: that it is from.
        components: in the order of a tick, sampled ones first.
        feeds: what joins them.
        beginnings: by component.
        starts: of each input port that nothing within feeds, by its name; its port and its values at the start.
        start: where the platform is at the beginning (3,), m.
    """

    name: str
    experiment: Experiment
    components: tuple[NativeComponent, ...]
    feeds: Feeds
    beginnings: Mapping[str, tuple[Beginning, ...]]
    starts: Mapping[str, tuple[Port, np.ndarray]]
    start: Sequence[float]

    def component(self, name: str) -> NativeComponent | None:
        """The component called that, if the part has it."""
        return next((component for component in self.components if component.name == name), None)


def told_to_drives(part: RobotPart) -> dict[str, str]:
    """The output, `monitor.omega_ref`, that feeds each input port of the drives; those of other parts are left out."""
    (drives,) = (row for row in ROBOT if row.name == DRIVE)
    fed = {
        port: [f"{source}.{name}" for source, name in sources if part.component(source)]
        for port, sources in drives.inputs.items()
    }
    return {port: found[0] for port, found in fed.items() if found}


def part_of(experiment: Experiment, name: str) -> RobotPart:
    """The part `name` of the robot of `experiment`.

    Raises:
        InputRefused: there is no such part, or it cannot be taken out of the experiment.
    """
    _refuse_broken(experiment)
    plant, theta_m = at_rest(experiment, "body" in experiment.stand_ins)
    build = Build(experiment, (), HERE, plant, theta_m)
    makers = {
        row.name: row.parts(build) if row.name != DRIVE and row.name not in experiment.stand_ins else {}
        for row in ROBOT
    }
    known = [*PARTS, *(row for row, found in makers.items() if found and row not in PARTS)]
    wanted = PARTS.get(name, (name,))
    _refuse_others(experiment, name, wanted)
    if name not in known:
        hint = nearest(name, known, "parts are {}")
        raise InputRefused(f"{name}: no part of {experiment.name} that can be built; {hint}")
    made = {row: [make() for make in found.values()] if row in wanted else [] for row, found in makers.items()}
    feeds = connected(made)
    components = sorted((c for row in made.values() for c in row), key=lambda c: not c.sampled)
    native = tuple(_native(component) for component in components)
    beginnings: dict[str, tuple[Beginning, ...]] = {}
    if made["plant"]:
        moving = len(plant.inputs) > len(plant_inputs(False, False))
        beginnings["plant"] = Beginning(outputs_at_start(moving, False)), Beginning(rest, REST_OUTPUTS)
    starts = {
        port.name: (port, _value_at_start(component, port, build))
        for component in native
        for port in component.inputs
        if End(component.name, port.name) not in feeds
    }
    return RobotPart(name, experiment, native, feeds, beginnings, starts, experiment.start)


def _refuse_broken(experiment: Experiment) -> None:
    """What an experiment does to its robot on the way is not part of the robot."""
    for found, table, remedy in (
        (experiment.faults, "fault", "what breaks in the other master is its own affair"),
        (experiment.changes, "change", "set the parameter at that time there"),
    ):
        if found:
            raise InputRefused(
                f"{experiment.name}: has [[{table}]] tables, which cannot be built; remove them: {remedy}"
            )


def _refuse_others(experiment: Experiment, name: str, wanted: Sequence[str]) -> None:
    if name.startswith(DRIVE):
        raise InputRefused(f"{name}: a drive is an FMU already; expected another part of {experiment.name}")
    for role in wanted:
        # the body's values come in from outside then
        if role in experiment.stand_ins and name != "plant":
            label = experiment.stand_ins[role].label
            raise InputRefused(
                f"{experiment.name}: its {role} is {label}, of another make; only twin's own can be built"
            )
    if "plant" in wanted and experiment.cosim.inputs == "linear":
        raise InputRefused(
            f'{experiment.name}: [cosim] inputs = "linear": an FMU holds its inputs over a step; '
            "build the plant with --set cosim.inputs=hold"
        )
    if "body" in wanted and name == "body" and not motions(experiment):
        raise InputRefused(f"{experiment.name}: its body does not move; there is nothing to build")


def _native(component: Component) -> NativeComponent:
    if not isinstance(component, NativeComponent) or not component.portable:
        raise InputRefused(f"{component.name}: works on memory that cannot be taken elsewhere; build another part")
    return component


def _value_at_start(component: Component, port: Port, build: Build) -> np.ndarray:
    """What comes in at the start of the experiment, the robot at rest; 0 for what nobody has worked out yet."""
    row = next(row for row in ROBOT if row.name == component.name)
    for source, name in row.inputs.get(port.name, ()):
        if source == DRIVE and name == "theta_m":
            return np.array(build.theta_m)
        if source == "plant":
            return by_port(build.plant.outputs, build.plant.initial_outputs)[name].copy()
    return np.zeros(width((port,)))
