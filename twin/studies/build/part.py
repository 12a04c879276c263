"""An exported part of the robot: components, inner wires, outer inputs."""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np

from twin.kernel.cosim.component import Component, NativeComponent
from twin.kernel.cosim.delay import filled
from twin.kernel.cosim.port import Port, width
from twin.kernel.cosim.system import End, Feeds
from twin.kernel.errors import InputRefused, nearest
from twin.robot.assembly.assemble import HERE, ROBOT, ComponentRow, broken, connected
from twin.robot.assembly.build import JOINTS, Build, at_rest
from twin.robot.assembly.roles import CONTRACTS
from twin.robot.experiment.experiment import Experiment
from twin.robot.plant.component import REST_OUTPUTS, outputs_at_start, rest
from twin.robot.plant.component import inputs as plant_inputs
from twin.studies.build.drives import refuse_broken, refuse_changed, refuse_others

DRIVE = "drive"
COMMANDS = (Port("omega_ref", JOINTS, "rad/s"), Port("tau_load", JOINTS, "N m"))
SHAFTS = (Port("theta_m", JOINTS, "rad"),)
PARTS = {
    "plant": ("body", "scale", "plant"),
    "computer": ("latency", "encoder", "estimator", "controller", "tank", "delay", "monitor"),
    "controls": ("estimator", "controller", "tank", "delay", "monitor"),
}
"""Parts of several components, as far as an experiment has them; any other component is one by its name. The bus is not
the computer's: where all exchange their values between steps, these take the time that it takes."""


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


def drive_commands(part: RobotPart) -> dict[str, str]:
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
    plant, theta_m = at_rest(experiment, "body" in experiment.stand_ins)
    build = Build(experiment, (), HERE, plant, theta_m)
    made = {row.name: _made(row, build) for row in ROBOT}
    sound = connected(made)
    components, feeds = broken(experiment, [component for row in made.values() for component in row], sound)
    native = [component for component in components if isinstance(component, NativeComponent) and component.portable]
    known = [component.name for component in native]
    wanted = [component for component in PARTS.get(name, (name,)) if component in known]
    refuse_others(experiment, name, PARTS.get(name, (name,)))
    if not wanted:
        hint = nearest(name, dict.fromkeys([*PARTS, *known]), "parts are {}")
        raise InputRefused(f"{name}: no part of {experiment.name} that can be built; {hint}")
    refuse_changed(experiment, wanted)
    refuse_broken(experiment, name, wanted, sound, feeds)
    chosen = sorted((c for c in native if c.name in wanted), key=lambda component: not component.sampled)
    within = {target: source for target, source in feeds.items() if {target.component, source.component} <= {*wanted}}
    beginnings: dict[str, tuple[Beginning, ...]] = {}
    if "plant" in wanted:
        moving = len(plant.inputs) > len(plant_inputs(False, False))
        beginnings["plant"] = Beginning(outputs_at_start(moving, False)), Beginning(rest, REST_OUTPUTS)
    if "latency" in wanted:
        beginnings["latency"] = (Beginning(filled),)
    starts = {
        port.name: (port, _at_start(component, port, components, feeds))
        for component in chosen
        for port in component.inputs
        if End(component.name, port.name) not in within
    }
    return RobotPart(name, experiment, tuple(chosen), within, beginnings, starts, experiment.start)


def _made(row: ComponentRow, build: Build) -> list[Component]:
    """The components of a row; of drives and third-party parts nothing but the ports."""
    if row.name == DRIVE:
        return [Component(DRIVE, COMMANDS, SHAFTS, False, 0, 0, build.theta_m)]
    if row.name in build.experiment.stand_ins:
        inputs, outputs, _ = CONTRACTS[row.name]
        return [Component(row.name, inputs, outputs, True, 0, 0, np.zeros(width(outputs)))]
    return [make() for make in row.parts(build).values()]


def _at_start(component: Component, port: Port, components: Sequence[Component], feeds: Feeds) -> np.ndarray:
    """What comes in at the start of the experiment, the robot at rest; 0 for an input without a source."""
    values = np.zeros(port.size)
    for n in range(port.size):
        source = feeds.get(End(component.name, port.name, n))
        if source is not None:
            feeder = next(other for other in components if other.name == source.component)
            values[n] = feeder.initial(source.port)[source.element]
    return values
