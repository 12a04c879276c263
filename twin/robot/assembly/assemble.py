"""Assembly of the robot: a table of components, built, wired, and with faults inserted.

The table lists the components in the order of a tick, with the sources of their inputs. A row has no component (an
experiment without a scale), one, or three (a drive for each joint). An input that a component lacks is skipped: a
plant on a surface at rest has no `s_B`. Values are joined in order, so three drives of one axis and one drive of
three axes are wired alike; a single value may feed many inputs.

Tunable parameters are numbers in a component's record that are written between two ticks. The integral of a loop is
kept in units of its output (`controller/pid.py`), so a new ki acts on future errors only; a new kp moves the output
by the error times its change; a new reference is a step of the reference.
"""

from collections.abc import Mapping, Sequence
from contextlib import ExitStack
from dataclasses import dataclass, field
from functools import partial
from types import MappingProxyType
from typing import TYPE_CHECKING, Any, NamedTuple

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

if TYPE_CHECKING:
    from twin.robot.remote import RemoteLink

RowPort = tuple[str, str]
COMMAND_SOURCES = (
    "bus.omega_ref", "monitor.omega_ref", "remote.omega_ref", "delay.omega_ref", "tank.omega_ref",
    "controller.omega_ref",
)  # fmt: skip
"""Sources of the drives' commands: the last existing component on the way from the controller."""
POWER_SOURCES = ("bus.power", "monitor.power")
"""Sources of the power signal shared by all drives."""
DRIVE_POWER_SOURCES = ("bus.drive_power", "monitor.drive_power")
"""Sources of the power signals per drive, where drives have their own lines."""
BRAKE_SOURCES = ("bus.brake", "monitor.brake")
"""Sources of the signals that permit brakes to close."""
SHAFT_SOURCES = ("shaft.theta_m", "drive.theta_m")
"""Sources of the motor shaft angles; with unpowered shafts if the drives specify their behaviour without power."""
FORCE_REFERENCE = "controller.force.reference_N"
IN_PROCESS_MAKER = InProcessDrives()


class ComponentRow(NamedTuple):
    """One row of the table of the robot's components, with their constructors and the sources of their inputs.

    Attributes:
        name: name of the row, and of its component if there is only one.
        inputs: candidate sources (row, port) by port; the first one whose row has components is used.
    """

    name: str
    parts: Parts
    inputs: Mapping[str, tuple[RowPort, ...]]


def _row(name: str, parts: Parts, **inputs: str | tuple[str, ...]) -> ComponentRow:
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
        omega_ref=COMMAND_SOURCES[5:],
        p_B="estimator.p_B", J="estimator.J", F_ee_B="estimator.F_ee_B", valid="estimator.valid",
        sample="encoder.sample",
    ),
    _row("delay", build.delays, omega_ref=COMMAND_SOURCES[4:]),
    _row(
        "remote", build.remotes,
        count_m="encoder.count_m", count_l="encoder.count_l", sample="encoder.sample", F_z="scale.F_z",
        tau_motor="drive.tau_motor",
    ),
    _row(
        "monitor", build.monitors,
        omega_ref=COMMAND_SOURCES[2:], count_m="encoder.count_m", count_l="encoder.count_l", sample="encoder.sample",
        age="remote.age",
    ),
    _row(
        "bus", build.buses,
        omega_ref=COMMAND_SOURCES[1:], power=POWER_SOURCES[1:], drive_power=DRIVE_POWER_SOURCES[1:],
        brake=BRAKE_SOURCES[1:],
    ),
    _row("scale", build.scale, F_ee_B="plant.F_ee_B"),
    _row(
        "drive", joint_drives,
        omega_ref=COMMAND_SOURCES, tau_load="plant.tau_load", enable=(*DRIVE_POWER_SOURCES, *POWER_SOURCES),
    ),
    _row(
        "shaft", build.unpowered_shafts,
        theta_m="drive.theta_m", tau_load="plant.tau_load", power=(*DRIVE_POWER_SOURCES, *POWER_SOURCES),
        brake=BRAKE_SOURCES,
    ),
    _row("plant", build.plant, theta_m=SHAFT_SOURCES, theta_m_start=SHAFT_SOURCES, s_B="body.s_B", v_s_B="body.v_s_B"),
)  # fmt: skip
"""All rows, in the order of evaluation within a tick."""


def connect_components(made: Mapping[str, list[Component]]) -> Feeds:
    """Wire the robot's components, given by table row, and return the source of each input."""
    feeds: Feeds = {}
    for row in COMPONENT_ROWS:
        for port, sources in row.inputs.items():
            targets = ends(made[row.name], "input", port)
            there = _available_sources(sources, made)
            if targets and there:
                feeds.update(zip(targets, _output_values(there[0], made, targets), strict=True))
    return feeds


def _available_sources(sources: Sequence[RowPort], made: Mapping[str, list[Component]]) -> list[RowPort]:
    """Return the candidate sources of an input whose components exist in this robot.

    For power, a drive's own line is preferred to the common one.
    """
    there = [source for source in sources if made[source[0]]]
    return [source for source in there if ends(made[source[0]], "output", source[1])] or there


def _output_values(source: RowPort, made: Mapping[str, list[Component]], targets: list[End]) -> list[End]:
    """Return the element of an output port that feeds each target input.

    A single value feeds all targets; else there must be as many values as targets.
    """
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
    """A parameter of the experiment that can be changed between two ticks, with its place in memory.

    Attributes:
        number: value in the experiment's file, in the unit of its key.
        memory: view of the component's memory, SI; one number, or equal ones for x, y and z.
    """

    number: float
    memory: np.ndarray


def tunable_parameters(experiment: Experiment, system: System) -> dict[str, TunableParameter]:
    """Return the parameters that can be changed during a run of an assembled system, by their experiment keys.

    Parameters of a third-party controller are left out, as their memory is unknown.
    """
    found = {}
    for key, number in changeable_values(DECLARED_TABLES, experiment.values).items():
        memory = TUNABLE_PLACES[key].memory_of(system.component(TUNABLE_PLACES[key].component))
        if memory is not None:
            found[key] = TunableParameter(number, memory)
    return found


HOOKS.before_compiling.append(compile_in_background)


@dataclass
class Assembly:
    """The assembled robot: a system that owns its FMU instances. A context manager that frees them.

    Attributes:
        substituted: description of each substitute, by the name of the replaced component.
        resources: contexts of drives in other processes, closed last.
        third_party: third-party parts of the experiment, by role.
        components_by_row: components by row, without faults.
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
    remote: "RemoteLink | None" = None,
) -> Assembly:
    """Build and wire every component of the experiment's robot, and check that all parts fit.

    The robot starts at rest in static equilibrium at the first waypoint of its reference.

    Args:
        substitutes: replacements by component name: a component with the same ports, or, for a role of
            `ROLE_CONTRACTS`, a Python class or an instance.
        maker: creates the drives. Drives that cannot share one process get their own in any case.
        alive: existing components of the experiment, by name, used instead of new ones.
        remote: link to a remote controller, which commands the drives; None for the experiment's own controller.

    Raises:
        InputRefused: a drive FMU or a third-party part does not fit; all are checked before any is loaded. Or a
            substitute matches no component.
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
        parts = _row_makers(Build(experiment, plans, maker, *rest, others | given, remote))
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
    """Build the system from existing components, given by table row, with the experiment's faults and changes."""
    components, feeds = inject_faults(experiment, [c for row in made.values() for c in row], connect_components(made))
    cosim = experiment.cosim
    pairs = wires(feeds | _end_feeds(feeds, components), components)
    system = System(components, pairs, cosim.tick, cosim.scheme, cosim.inputs, cosim.iterations)
    places = [(change, TUNABLE_PLACES[change.key]) for change in experiment.changes]
    found = [(change, place.memory_of(system.component(place.component))) for change, place in places]
    # the memory of a third-party controller is unknown
    system.changes = tuple(MemoryChange(c.tick, memory, c.value) for c, memory in found if memory is not None)
    return system


def inject_faults(
    experiment: Experiment, components: Sequence[Component], feeds: Feeds
) -> tuple[list[Component], Feeds]:
    """Insert the experiment's faults into components and wiring, and return the changed components and wiring."""
    return inject(
        components,
        feeds,
        experiment.faults,
        experiment.cosim.tick,
        (experiment.plant.motor_counts_per_turn, experiment.plant.joint_counts_per_turn),
        experiment.controller.speed_limit,
    )


def _end_feeds(feeds: Feeds, components: Sequence[Component]) -> Feeds:
    """Return the wiring of the end-of-step inputs of components that read an input at both ends of a step."""
    asked = {(component.name, port.name) for component in components for port in component.inputs}
    both = {End(t.component, t.port + END_SUFFIX, t.element): source for t, source in feeds.items()}
    return {target: source for target, source in both.items() if (target.component, target.port) in asked}


def _row_makers(build: Build) -> dict[str, Makers]:
    """Return the component constructors of each row of the component table.

    A third-party part replaces all components of its row.
    """
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
    """Describe a component that replaces one of twin's own: the class of a user's model, or label and class."""
    own = component.__name__ if isinstance(component, type) else type(component).__name__
    if not isinstance(component, Component):
        return own
    return f"{component.label} ({own})" if component.label else own
