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
from twin.kernel.fmi.groups import AT_END
from twin.kernel.hooks import HOOKS
from twin.robot.assembly import build
from twin.robot.assembly.build import (
    Build,
    DriveMaker,
    InThisProcess,
    Makers,
    Parts,
    at_rest,
    joint_drives,
    need_processes,
    planned_drives,
)
from twin.robot.assembly.declared import DECLARED, PLACES
from twin.robot.assembly.drives import DrivePlan
from twin.robot.assembly.inject import inject
from twin.robot.assembly.roles import CONTRACTS, OtherPart, given_part, other_parts
from twin.robot.assembly.usual import compile_beside
from twin.robot.experiment.experiment import Experiment
from twin.robot.experiment.schema import changeable

Source = tuple[str, str]
COMMAND = ("bus.omega_ref", "monitor.omega_ref", "delay.omega_ref", "tank.omega_ref", "controller.omega_ref")
"""The drives' commands: the last component on the way from the controller."""
POWER = ("bus.power", "monitor.power")
"""Whether they may have power."""
DRIVE_POWER = ("bus.drive_power", "monitor.drive_power")
"""The same of each, where drives have lines of their own."""
BRAKE = ("bus.brake", "monitor.brake")
"""Whether brakes may close."""
SHAFT = ("shaft.theta_m", "drive.theta_m")
"""The motors' shafts: as they are without power, if the drives say it."""
FORCE_REFERENCE = "controller.force.reference_N"
HERE = InThisProcess()


class ComponentRow(NamedTuple):
    """Components of the robot.

    Attributes:
        name: of the row, and of its component if there is one.
        parts: what makes its components, if the experiment has any.
        inputs: by port (row, port), where it comes from; of several the first one whose row has components.
    """

    name: str
    parts: Parts
    inputs: Mapping[str, tuple[Source, ...]]


def _row(name: str, parts: Parts, **inputs: str | tuple[str, ...]) -> ComponentRow:
    """A row with its sources as "row.port"."""
    named = {port: (source,) if isinstance(source, str) else source for port, source in inputs.items()}
    return ComponentRow(name, parts, {port: tuple(map(_source, sources)) for port, sources in named.items()})


def _source(text: str) -> Source:
    row, _, port = text.partition(".")
    return row, port


ROBOT = (
    _row("body", build.body),
    _row("latency", build.latency, theta_m=SHAFT, theta_l="plant.theta_l"),
    _row(
        "encoder", build.encoder,
        theta_m=("latency.theta_m", *SHAFT), theta_l=("latency.theta_l", "plant.theta_l"),
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
        omega_ref=COMMAND[4:], p_B="estimator.p_B", J="estimator.J", F_ee_B="estimator.F_ee_B", valid="estimator.valid",
        sample="encoder.sample",
    ),
    _row("delay", build.delays, omega_ref=COMMAND[3:]),
    _row(
        "monitor", build.monitors,
        omega_ref=COMMAND[2:], count_m="encoder.count_m", count_l="encoder.count_l", sample="encoder.sample",
    ),
    _row(
        "bus", build.buses,
        omega_ref=COMMAND[1:], power=POWER[1:], drive_power=DRIVE_POWER[1:], brake=BRAKE[1:],
    ),
    _row("scale", build.scale, F_ee_B="plant.F_ee_B"),
    _row("drive", joint_drives, omega_ref=COMMAND, tau_load="plant.tau_load", enable=(*DRIVE_POWER, *POWER)),
    _row(
        "shaft", build.unpowered_shafts,
        theta_m="drive.theta_m", tau_load="plant.tau_load", power=(*DRIVE_POWER, *POWER), brake=BRAKE,
    ),
    _row("plant", build.plant, theta_m=SHAFT, theta_m_start=SHAFT, s_B="body.s_B", v_s_B="body.v_s_B"),
)  # fmt: skip
"""In the order in which a tick evaluates them."""


def connected(made: Mapping[str, list[Component]]) -> Feeds:
    """What feeds each input of the components of `made`, by row.

    Raises:
        InputRefused: a component has not the port, or not the number of values, that another one needs of it.
    """
    feeds: Feeds = {}
    for row in ROBOT:
        for port, sources in row.inputs.items():
            targets = ends(made[row.name], "input", port)
            there = _present(sources, made)
            if targets and there:
                feeds.update(zip(targets, _values(there[0], made, targets), strict=True))
    return feeds


def _present(sources: Sequence[Source], made: Mapping[str, list[Component]]) -> list[Source]:
    """Sources of an input in this robot: of power the drive's own line, or the one of all drives."""
    there = [source for source in sources if made[source[0]]]
    return [source for source in there if ends(made[source[0]], "output", source[1])] or there


def _values(source: Source, made: Mapping[str, list[Component]], targets: list[End]) -> list[End]:
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


HOOKS.before_compiling.append(compile_beside)


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
    home: ExitStack = field(default_factory=ExitStack)
    others: Mapping[str, OtherPart] = field(default_factory=dict)
    made: Mapping[str, list[Component]] = field(default_factory=dict)

    def __enter__(self) -> "Assembly":
        return self

    def __exit__(self, *failure: object) -> None:
        self.close()

    def close(self) -> None:
        with self.home:
            for component in self.system.components:
                component.close()


def assemble(
    experiment: Experiment,
    substitutes: Mapping[str, Any] | None = None,
    maker: DriveMaker = HERE,
    alive: Mapping[str, Component] = MappingProxyType({}),
) -> Assembly:
    """Build every component of `experiment` and wire them.

    The robot starts at rest in static equilibrium at the first way point of its reference.

    Args:
        substitutes: what takes the place of the components with their names: a component of the same ports, or, of a
            part in `CONTRACTS`, a Python class or an instance of one.
        maker: of the drives. What cannot live in one process gets processes of its own in any case.
        alive: components of the experiment that are there already, by their names: they are not made.

    Raises:
        InputRefused: a drive FMU or a third-party part does not fit; all are checked before any is loaded. Or a
            substitute for which there is no place.
    """
    plans = planned_drives(experiment)
    crowded = need_processes(plans) and maker.one_process
    if experiment.monitor is not None:
        plans = tuple(plan.switchable() for plan in plans)
    taken, home = dict(substitutes or {}), ExitStack()
    classes = {name: found for name, found in taken.items() if not isinstance(found, Component)}
    given = {role: given_part(role, found) for role, found in classes.items() if role in CONTRACTS}
    others = other_parts(experiment)
    with ExitStack() as to_close:
        to_close.push(home)
        if crowded:
            # its compiled code takes a while to load
            from twin.robot.assembly.isolated_drive import IsolatedDrives

            maker = home.enter_context(IsolatedDrives(keep=True))
        rest = at_rest(experiment, "body" in others | given)
        parts = _parts(Build(experiment, plans, maker, *rest, others | given))
        places = [name for makers in parts.values() for name in makers]
        if unplaced := [name for name in taken if name not in places]:
            hint = nearest(unplaced[0], places, "there are {}")
            raise InputRefused(f"substitutes: no component '{unplaced[0]}' in this experiment; {hint}")
        for name in classes.keys() - given.keys():
            raise InputRefused(f"substitutes: '{name}' takes a component; classes take {', '.join(CONTRACTS)}")
        made: dict[str, list[Component]] = {row: [] for row in parts}
        for row, makers in parts.items():
            for name, make in makers.items():
                ready = alive.get(name, taken.get(name) if name not in given else None)
                component = make() if ready is None else ready
                to_close.callback(component.close)
                made[row].append(component)
        system = joined(experiment, made)
        to_close.pop_all()
    return Assembly(system, plans, {name: _kind(taken[name]) for name in taken}, home, others, made)


def joined(experiment: Experiment, made: Mapping[str, list[Component]]) -> System:
    """The system of the components `made`, by row, with the faults and the changes of `experiment` in it.

    Raises:
        InputRefused: components or a fault do not fit.
    """
    components, feeds = broken(experiment, [c for row in made.values() for c in row], connected(made))
    cosim = experiment.cosim
    pairs = wires(feeds | _at_end(feeds, components), components)
    system = System(components, pairs, cosim.tick, cosim.scheme, cosim.inputs, cosim.iterations)
    system.changes = scheduled(experiment, system)
    return system


def broken(experiment: Experiment, components: Sequence[Component], feeds: Feeds) -> tuple[list[Component], Feeds]:
    """The same robot with the faults of `experiment` in it, see `inject`."""
    return inject(
        components,
        feeds,
        experiment.faults,
        experiment.cosim.tick,
        (experiment.plant.motor_counts_per_turn, experiment.plant.joint_counts_per_turn),
        experiment.controller.speed_limit,
    )


def _at_end(feeds: Feeds, components: Sequence[Component]) -> Feeds:
    """What feeds those inputs that are asked for at both ends of a step, at its end."""
    asked = {(component.name, port.name) for component in components for port in component.inputs}
    both = {End(t.component, t.port + AT_END, t.element): source for t, source in feeds.items()}
    return {target: source for target, source in both.items() if (target.component, target.port) in asked}


def _parts(build: Build) -> dict[str, Makers]:
    """What makes the components of each row; of a third-party part, that alone."""
    experiment = build.experiment
    periods = {"monitor": experiment.monitor_ticks, "scale": experiment.scale_ticks, "body": 1}
    return {
        row.name: {
            row.name: partial(
                build.others[row.name].make,
                experiment.cosim.tick,
                periods.get(row.name, experiment.controller_ticks),
                experiment.duration_ticks,
            )
        }
        if row.name in build.others
        else row.parts(build)
        for row in ROBOT
    }


def _kind(component: Any) -> str:
    """What a substitute is: the class of a user's model, or that of the component."""
    own = component.__name__ if isinstance(component, type) else type(component).__name__
    if not isinstance(component, Component):
        return own
    return f"{component.label} ({own})" if component.label else own
