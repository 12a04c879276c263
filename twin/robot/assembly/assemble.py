"""The robot assembled: one table of components, built, wired, with faults inserted.

The table has the components in the order of a tick, and where each of their inputs comes from. A row may stand for no
component at all (an experiment without a scale), for one, or for three (a drive for each joint). Its inputs are those
that its components have: a plant on a body that does not move has no `s_B`. Values are joined in order, so three drives
of one axis and one drive of three axes are wired alike; one value feeds many.

What of an experiment may be changed while it runs, and where the controller keeps it. A change is a number written into
the controller's record between two ticks. Nothing jumps but what has to: the integral of a loop is kept in units of its
output (`controller/pid.py`), so a new ki acts on errors to come only; a new kp moves the output by the error times its
change; a new reference is a step of the reference.
"""

from collections.abc import Mapping, Sequence
from contextlib import ExitStack
from dataclasses import dataclass, field
from functools import partial
from types import MappingProxyType
from typing import Any, NamedTuple

import numpy as np

from twin.kernel.cosim.component import Component
from twin.kernel.cosim.system import End, Feeds, MemoryChange, System, ends, wires
from twin.kernel.errors import InputRefused, nearest
from twin.kernel.fmi.groups import END_SUFFIX
from twin.kernel.hooks import HOOKS
from twin.robot.assembly import build
from twin.robot.assembly.build import (
    Build,
    DriveMaker,
    InProcessDrives,
    Makers,
    Parts,
    joint_drives,
    need_processes,
    planned_drives,
    resting_plant,
)
from twin.robot.assembly.declared import DECLARED_TABLES, TUNABLE_PLACES
from twin.robot.assembly.drives import DrivePlan
from twin.robot.assembly.inject import inject
from twin.robot.assembly.precompile import compile_in_background
from twin.robot.assembly.roles import ROLE_CONTRACTS, ThirdPartyPart, part_from_class, third_party_parts
from twin.robot.experiment.experiment import Experiment
from twin.robot.experiment.schema import changeable_values

RowPort = tuple[str, str]
COMMAND_SOURCES = ("bus.omega_ref", "monitor.omega_ref", "delay.omega_ref", "tank.omega_ref", "controller.omega_ref")
"""The drives' commands: the last component on the way from the controller."""
POWER_SOURCES = ("bus.power", "monitor.power")
"""Whether they may have power."""
DRIVE_POWER_SOURCES = ("bus.drive_power", "monitor.drive_power")
"""The same of each, where drives have lines of their own."""
BRAKE_SOURCES = ("bus.brake", "monitor.brake")
"""Whether brakes may close."""
SHAFT_SOURCES = ("shaft.theta_m", "drive.theta_m")
"""The motors' shafts: as they are without power, if the drives say it."""
FORCE_REFERENCE = "controller.force.reference_N"
IN_PROCESS_MAKER = InProcessDrives()


class ComponentRow(NamedTuple):
    """Components of the robot.

    Attributes:
        name: of the row, and of its component if there is one.
        parts: what makes its components, if the experiment has any.
        inputs: by port (row, port), where it comes from; of several the first one whose row has components.
    """

    name: str
    parts: Parts
    inputs: Mapping[str, tuple[RowPort, ...]]


def _row(name: str, parts: Parts, **inputs: str | tuple[str, ...]) -> ComponentRow:
    """A row with its sources as "row.port"."""
    named = {port: (source,) if isinstance(source, str) else source for port, source in inputs.items()}
    return ComponentRow(name, parts, {port: tuple(map(_parse_row_port, sources)) for port, sources in named.items()})


def _parse_row_port(text: str) -> RowPort:
    row, _, port = text.partition(".")
    return row, port


COMPONENT_ROWS = (
    _row("body", build.body),
    _row("latency", build.latency, theta_m=SHAFT_SOURCES, theta_l="plant.theta_l"),
    _row(
        "encoder", build.encoder,
        theta_m=("latency.theta_m", *SHAFT_SOURCES), theta_l=("latency.theta_l", "plant.theta_l"),
    ),
    _row("estimator", build.estimators, count_m="encoder.count_m", count_l="encoder.count_l"),
    _row("reference", build.references),
    _row(
        "controller", build.controllers,
        p_ref_B="reference.p_ref_B",
        p_B="estimator.p_B", J="estimator.J", F_ee_B="estimator.F_ee_B", tau_l="estimator.tau_l",
        share="tank.share",
    ),
    _row(
        "tank", build.tanks,
        omega_ref=COMMAND_SOURCES[4:], p_B="estimator.p_B", J="estimator.J", F_ee_B="estimator.F_ee_B", valid="estimator.valid",
        sample="encoder.sample",
    ),
    _row("delay", build.delays, omega_ref=COMMAND_SOURCES[3:]),
    _row(
        "monitor", build.monitors,
        omega_ref=COMMAND_SOURCES[2:], count_m="encoder.count_m", count_l="encoder.count_l", sample="encoder.sample",
    ),
    _row(
        "bus", build.buses,
        omega_ref=COMMAND_SOURCES[1:], power=POWER_SOURCES[1:], drive_power=DRIVE_POWER_SOURCES[1:], brake=BRAKE_SOURCES[1:],
    ),
    _row("scale", build.scale, F_ee_B="plant.F_ee_B"),
    _row("drive", joint_drives, omega_ref=COMMAND_SOURCES, tau_load="plant.tau_load", enable=(*DRIVE_POWER_SOURCES, *POWER_SOURCES)),
    _row(
        "shaft", build.unpowered_shafts,
        theta_m="drive.theta_m", tau_load="plant.tau_load", power=(*DRIVE_POWER_SOURCES, *POWER_SOURCES), brake=BRAKE_SOURCES,
    ),
    _row("plant", build.plant, theta_m=SHAFT_SOURCES, theta_m_start=SHAFT_SOURCES, s_B="body.s_B", v_s_B="body.v_s_B"),
)  # fmt: skip
"""In the order in which a tick evaluates them."""


def connect_components(made: Mapping[str, list[Component]]) -> Feeds:
    """What feeds each input of the components of `made`, by row.

    Raises:
        InputRefused: a component has not the port, or not the number of values, that another one needs of it.
    """
    feeds: Feeds = {}
    for row in COMPONENT_ROWS:
        for port, sources in row.inputs.items():
            targets = ends(made[row.name], "input", port)
            there = _available_sources(sources, made)
            if targets and there:
                feeds.update(zip(targets, _output_values(there[0], made, targets), strict=True))
    return feeds


def _available_sources(sources: Sequence[RowPort], made: Mapping[str, list[Component]]) -> list[RowPort]:
    """Sources of an input in this robot: of power the drive's own line, or the one of all drives."""
    there = [source for source in sources if made[source[0]]]
    return [source for source in there if ends(made[source[0]], "output", source[1])] or there


def _output_values(source: RowPort, made: Mapping[str, list[Component]], targets: list[End]) -> list[End]:
    """A value of the output `source` for each of `targets`."""
    name, port = source
    values = ends(made[name], "output", port)
    first = targets[0]
    if not values:
        offered = ", ".join(p.name for component in made[name] for p in component.outputs) or "none"
        raise InputRefused(
            f"{name}: has no output '{port}', which {first.component}.{first.port} needs; it has {offered}"
        )
    if len(values) == 1:
        return values * len(targets)
    if len(values) != len(targets):
        raise InputRefused(
            f"wire {name}.{port} -> {first.component}.{first.port}: {len(values)} values into {len(targets)}"
        )
    return values


class TunableParameter(NamedTuple):
    """A number that may be changed between two ticks.

    Attributes:
        number: what the experiment's file says, in the unit of its key.
        memory: where its component keeps it, SI; one number, or the same for x, y and z.
    """

    number: float
    memory: np.ndarray


def tunable_parameters(experiment: Experiment, system: System) -> dict[str, TunableParameter]:
    """What may be changed in `system`, which was assembled of `experiment`, by its key in the experiment's file.

    Nothing of a controller that keeps it elsewhere than ours.
    """
    found = {}
    for key, number in changeable_values(DECLARED_TABLES, experiment.values).items():
        memory = TUNABLE_PLACES[key].memory_of(system.component(TUNABLE_PLACES[key].component))
        if memory is not None:
            found[key] = TunableParameter(number, memory)
    return found


def scheduled_changes(experiment: Experiment, system: System) -> tuple[MemoryChange, ...]:
    """The experiment's own changes, for `system`, which was assembled of it."""
    found = tunable_parameters(experiment, system)
    return tuple(MemoryChange(c.tick, found[c.key].memory, c.value) for c in experiment.changes if c.key in found)


HOOKS.before_compiling.append(compile_in_background)


@dataclass
class Assembly:
    """A system that owns its FMU instances; a context manager that frees them.

    Attributes:
        system: ready to be simulated.
        drives: what stands behind the three joints.
        substituted: what took the place of the experiment's own components, by their names.
        home: of drives that live elsewhere; it goes last.
        others: the experiment's third-party parts, by their names.
        made: the components by row; faults are none of them.
    """

    system: System
    drives: tuple[DrivePlan, ...]
    substituted: dict[str, str] = field(default_factory=dict)
    resources: ExitStack = field(default_factory=ExitStack)
    third_party: Mapping[str, ThirdPartyPart] = field(default_factory=dict)
    components_by_row: Mapping[str, list[Component]] = field(default_factory=dict)

    def __enter__(self) -> "Assembly":
        return self

    def __exit__(self, *failure: object) -> None:
        self.close()

    def close(self) -> None:
        with self.resources:
            for component in self.system.components:
                component.close()


def assemble(
    experiment: Experiment,
    substitutes: Mapping[str, Any] | None = None,
    maker: DriveMaker = IN_PROCESS_MAKER,
    alive: Mapping[str, Component] = MappingProxyType({}),
) -> Assembly:
    """Build every component of `experiment` and wire them.

    The robot starts at rest in static equilibrium at the first way point of its reference.

    Args:
        substitutes: what takes the place of the components with their names: a component of the same ports, or, of a
            part in `ROLE_CONTRACTS`, a Python class or an instance of one.
        maker: of the drives. What cannot live in one process gets processes of its own in any case.
        alive: components of the experiment that are there already, by their names: they are not made.

    Raises:
        InputRefused: a drive FMU or a third-party part does not fit; all are checked before any is loaded. Or a
            substitute for which there is no place.
    """
    plans = planned_drives(experiment)
    crowded = need_processes(plans) and maker.one_process
    if experiment.monitor is not None:
        plans = tuple(plan.with_enable_input() for plan in plans)
    taken, home = dict(substitutes or {}), ExitStack()
    classes = {name: found for name, found in taken.items() if not isinstance(found, Component)}
    given = {role: part_from_class(role, found) for role, found in classes.items() if role in ROLE_CONTRACTS}
    others = third_party_parts(experiment)
    with ExitStack() as to_close:
        to_close.push(home)
        if crowded:
            # its compiled code takes a while to load
            from twin.robot.assembly.isolated_drive import IsolatedDrives

            maker = home.enter_context(IsolatedDrives(keep=True))
        rest = resting_plant(experiment, "body" in others | given)
        parts = _row_makers(Build(experiment, plans, maker, *rest, others | given))
        places = [name for makers in parts.values() for name in makers]
        if unplaced := [name for name in taken if name not in places]:
            hint = nearest(unplaced[0], places, "there are {}")
            raise InputRefused(f"substitutes: no component '{unplaced[0]}' in this experiment; {hint}")
        for name in classes.keys() - given.keys():
            raise InputRefused(f"substitutes: '{name}' takes a component; classes take {', '.join(ROLE_CONTRACTS)}")
        made: dict[str, list[Component]] = {row: [] for row in parts}
        for row, makers in parts.items():
            for name, make in makers.items():
                ready = alive.get(name, taken.get(name) if name not in given else None)
                component = make() if ready is None else ready
                to_close.callback(component.close)
                made[row].append(component)
        system = assemble_system(experiment, made)
        to_close.pop_all()
    return Assembly(system, plans, {name: _substitute_label(taken[name]) for name in taken}, home, others, made)


def assemble_system(experiment: Experiment, made: Mapping[str, list[Component]]) -> System:
    """The system of the components `made`, by row, with the faults and the changes of `experiment` in it.

    Raises:
        InputRefused: components or a fault do not fit.
    """
    components, feeds = inject_faults(experiment, [c for row in made.values() for c in row], connect_components(made))
    cosim = experiment.cosim
    pairs = wires(feeds | _end_feeds(feeds, components), components)
    system = System(components, pairs, cosim.tick, cosim.scheme, cosim.inputs, cosim.iterations)
    system.changes = scheduled_changes(experiment, system)
    return system


def inject_faults(
    experiment: Experiment, components: Sequence[Component], feeds: Feeds
) -> tuple[list[Component], Feeds]:
    """The same robot with the faults of `experiment` in it, see `inject`."""
    return inject(
        components,
        feeds,
        experiment.faults,
        experiment.cosim.tick,
        (experiment.plant.motor_counts_per_turn, experiment.plant.joint_counts_per_turn),
        experiment.controller.speed_limit,
    )


def _end_feeds(feeds: Feeds, components: Sequence[Component]) -> Feeds:
    """What feeds those inputs that are asked for at both ends of a step, at its end."""
    asked = {(component.name, port.name) for component in components for port in component.inputs}
    both = {End(t.component, t.port + END_SUFFIX, t.element): source for t, source in feeds.items()}
    return {target: source for target, source in both.items() if (target.component, target.port) in asked}


def _row_makers(build: Build) -> dict[str, Makers]:
    """What makes the components of each row; of a third-party part, that alone."""
    experiment = build.experiment
    periods = {"monitor": experiment.monitor_ticks, "scale": experiment.scale_ticks, "body": 1}
    return {
        row.name: {
            row.name: partial(
                build.third_party[row.name].make,
                experiment.cosim.tick,
                periods.get(row.name, experiment.controller_ticks),
                experiment.duration_ticks,
            )
        }
        if row.name in build.third_party
        else row.parts(build)
        for row in COMPONENT_ROWS
    }


def _substitute_label(component: Any) -> str:
    """What a substitute is: the class of a user's model, or that of the component."""
    own = component.__name__ if isinstance(component, type) else type(component).__name__
    if not isinstance(component, Component):
        return own
    return f"{component.label} ({own})" if component.label else own
