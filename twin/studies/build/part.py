"""An exported part of the robot: components, inner connections, outer inputs, open parameters and fixed keys.

An open parameter has a place in the memory of a component that contains its SI value, possibly divided or multiplied by
a constant; so all derived values follow when it is written. Keys without such a place are fixed: they determine the
number of ticks or phases or the active law, or Python computes values from them.
"""

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass
from typing import Any, NamedTuple

import numpy as np

from twin.kernel.cosim.component import Component, MemoryPlace, NativeComponent
from twin.kernel.cosim.delay import fill_ring
from twin.kernel.cosim.port import Port, width
from twin.kernel.cosim.system import End, Feeds
from twin.kernel.errors import InputRefused, nearest
from twin.kernel.settings import setting_fields
from twin.kernel.units import Unit, known_unit
from twin.robot.assembly.assemble import (
    COMPONENT_ROWS,
    IN_PROCESS_MAKER,
    ComponentRow,
    connect_components,
    inject_faults,
)
from twin.robot.assembly.build import JOINTS, Build, resting_plant
from twin.robot.assembly.declared import SETTING_MEMORIES, TABLE_PATHS, TUNABLE_PLACES
from twin.robot.assembly.roles import ROLE_CONTRACTS
from twin.robot.experiment.experiment import Experiment
from twin.robot.experiment.fault import FAULT_KINDS, Fault, fault_table_model
from twin.robot.faults import FaultComponent
from twin.robot.mechanism.geometry import Model
from twin.robot.plant.component import plant_inputs as plant_inputs
from twin.robot.plant.equations import REST_OUTPUTS, outputs_at_start, rest
from twin.studies.build.refusals import refuse_changes, refuse_inner_faults, refuse_unbuildable

DRIVE_ROW = "drive"
DRIVE_INPUTS = (Port("omega_ref", JOINTS, "rad/s"), Port("tau_load", JOINTS, "N m"))
DRIVE_OUTPUTS = (Port("theta_m", JOINTS, "rad"),)
PART_COMPONENTS = {
    "plant": ("body", "scale", "plant"),
    "computer": ("latency", "encoder", "estimator", "controller", "tank", "delay", "monitor"),
    "controls": ("estimator", "controller", "tank", "delay", "monitor"),
}
"""Components of each part, as far as an experiment has them; any other component is a part under its own name.

The bus is not in the computer: a Jacobi master delays by a tick as the bus does.
"""
START_KEY = "start.p_B"
_TABLE_ORDER = (
    "plant", "robot", "contact", "contact.breathing", "contact.shift", "scale", "controller", "controller.model",
    "controller.force", "controller.position", "controller.touch", "controller.feed_forward", "controller.damping",
    "controller.tissue", "controller.breath", "controller.energy_tank",
)  # fmt: skip
"""Order of the parameters by table."""
_FIRST_KEYS = {
    "contact": (
        "height", "tilt", "tilt_x", "stiffness", "friction", "bristle", "bristle_damping", "damping", "exponent",
        "reference_depth", "damper", "touch_depth", "stiffening", "radius",
    ),
    "contact.breathing": ("amplitude", "start", "rate", "end"),
    "controller.force": ("limit", "filter", "kp", "ki", "kd", "derivative_filter", "follow", "rate"),
    "controller.energy_tank": ("size", "horizon", "touch", "bias", "release"),
}  # fmt: skip
"""Keys per table that come first, as in FMUs of earlier builds; the others follow in memory order."""
_TABLE_MODELS = {path: table for table, path in TABLE_PATHS.items()}
Limits = tuple[float | None, float | None, float | None, float | None]
"""Above, at least, below, at most; None where unlimited."""
NO_LIMITS: Limits = (None, None, None, None)
_FIXED_KEYS = {
    "plant": ("plant.substeps", "contact.law", "contact.shape"),
    "scale": ("scale.period_ms",),
    "latency": ("plant.encoder_latency_ms",),
    "encoder": ("seed", "controller.period_ms"),
    "estimator": ("controller.gravity_compensation", "controller.period_ms"),
    "controller": (
        "controller.mode", "controller.period_ms", "controller.speed_limit_rad_per_s", "controller.force.reference_N",
        "controller.force.trigger_N", "controller.force.trigger_time_s", "controller.touch.contact_N", "[reference]",
        "[approach]", "[[task]]", "controller.force.schedule",
    ),
    "tank": ("controller.period_ms",),
    "delay": ("controller.delay_ticks",),
    "monitor": ("[monitor]",),
    **{f"shaft_{joint}": ("[drive.unpowered]",) for joint in range(1, JOINTS + 1)},
}  # fmt: skip
"""Keys that affect each component and may be fixed in it, unless they are open parameters."""


@dataclass(frozen=True)
class Beginning:
    """A compiled function of an exported component that is called once before the first step.

    Its own outputs are empty if it writes the component's.
    """

    step: Any
    outputs: tuple[Port, ...] = ()


@dataclass(frozen=True)
class RobotPart:
    """A part of the robot to export: components in the order of a tick, sampled ones first, with inner connections.

    Attributes:
        beginnings: initial functions by component.
        starts: name of each input port without an inner source -> its port and start values.
        start: position of the platform at the start (3,), m.
    """

    name: str
    experiment: Experiment
    components: tuple[NativeComponent, ...]
    feeds: Feeds
    beginnings: Mapping[str, tuple[Beginning, ...]]
    starts: Mapping[str, tuple[Port, np.ndarray]]
    start: Sequence[float]

    def component(self, name: str) -> NativeComponent | None:
        return next((component for component in self.components if component.name == name), None)


def drive_commands(part: RobotPart) -> dict[str, str]:
    """Return the drive inputs that an exported part feeds, each with the output that feeds it."""
    (drives,) = (row for row in COMPONENT_ROWS if row.name == DRIVE_ROW)
    fed = {
        port: [
            f"{source}.{name}"
            for source, name in sources
            if (owner := part.component(source)) and any(output.name == name for output in owner.outputs)
        ]
        for port, sources in drives.inputs.items()
    }
    return {port: found[0] for port, found in fed.items() if found}


def part_of(experiment: Experiment, name: str) -> RobotPart:
    """Build a part of the experiment's robot for export, such as "plant" or "computer"."""
    plant, theta_m = resting_plant(experiment, "body" in experiment.stand_ins)
    build = Build(experiment, (), IN_PROCESS_MAKER, plant, theta_m)
    made = {row.name: _row_components(row, build) for row in COMPONENT_ROWS}
    sound = connect_components(made)
    components, feeds = inject_faults(experiment, [component for row in made.values() for component in row], sound)
    native = [component for component in components if isinstance(component, NativeComponent) and component.portable]
    known = [component.name for component in native]
    wanted = [component for component in PART_COMPONENTS.get(name, (name,)) if component in known]
    refuse_unbuildable(experiment, name, PART_COMPONENTS.get(name, (name,)))
    if not wanted:
        hint = nearest(name, dict.fromkeys([*PART_COMPONENTS, *known]), "parts are {}")
        raise InputRefused(f"{name}: no part of {experiment.name} that can be built; {hint}")
    refuse_changes(experiment, wanted)
    refuse_inner_faults(experiment, name, wanted, sound, feeds)
    chosen = sorted((c for c in native if c.name in wanted), key=lambda component: not component.sampled)
    within = {target: source for target, source in feeds.items() if {target.component, source.component} <= {*wanted}}
    beginnings: dict[str, tuple[Beginning, ...]] = {}
    if "plant" in wanted:
        moving = len(plant.inputs) > len(plant_inputs(False, False))
        beginnings["plant"] = Beginning(outputs_at_start(moving, False)), Beginning(rest, REST_OUTPUTS)
    if "latency" in wanted:
        beginnings["latency"] = (Beginning(fill_ring),)
    starts = {
        port.name: (port, _start_values(component, port, components, feeds))
        for component in chosen
        for port in component.inputs
        if End(component.name, port.name) not in within
    }
    return RobotPart(name, experiment, tuple(chosen), within, beginnings, starts, experiment.start)


def _row_components(row: ComponentRow, build: Build) -> list[Component]:
    """Create the components of one row of `COMPONENT_ROWS`, for export.

    Drives and third-party parts are not exported: a placeholder without a step, with their ports and initial outputs,
    represents them in the wiring.
    """
    if row.name == DRIVE_ROW:
        return [Component(DRIVE_ROW, DRIVE_INPUTS, DRIVE_OUTPUTS, False, 0, 0, build.theta_m)]
    if row.name in build.experiment.stand_ins:
        inputs, outputs, _ = ROLE_CONTRACTS[row.name]
        return [Component(row.name, inputs, outputs, True, 0, 0, np.zeros(width(outputs)))]
    return [make() for make in row.parts(build).values()]


def _start_values(component: Component, port: Port, components: Sequence[Component], feeds: Feeds) -> np.ndarray:
    """Return the values of an exported input with the robot at rest at the start; 0 without a source."""
    values = np.zeros(port.size)
    for n in range(port.size):
        source = feeds.get(End(component.name, port.name, n))
        if source is not None:
            feeder = next(other for other in components if other.name == source.component)
            values[n] = feeder.initial(source.port)[source.element]
    return values


def fault_of(experiment: Experiment, name: str) -> Fault | None:
    """Return the experiment's fault with the component name `fault_1` or similar; None for any other component."""
    return next((fault for n, fault in enumerate(experiment.faults, start=1) if name == f"fault_{n}"), None)


def related_keys(fault: Fault) -> tuple[str, ...]:
    """Return the experiment's keys in other tables that affect a fault's component."""
    match FAULT_KINDS[fault.kind].mechanism:
        case "counts":
            side = "motor" if fault.target.startswith("motor") else "joint"
            return (f"plant.{side}_counts_per_turn", "controller.period_ms")
        case "message":
            return ("controller.period_ms",)
        case "drive":
            return ("start.p_B",)
    return ("controller.speed_limit_rad_per_s",) if fault.kind == "brown_out" else ()


class Destination(NamedTuple):
    """Place in an exported component's memory that a parameter is written to: SI value / divisor * times.

    The memory has one element per value, or any number that share one value.
    """

    component: str
    memory: np.ndarray
    divisor: float = 1.0
    times: float = 1.0


class OpenParameter(NamedTuple):
    """A number of the experiment's file that can still be set in the exported part.

    Attributes:
        key: key of the file, e.g. `plant.k_s_Nm_per_rad`.
        unit: unit of the values; `text` as the file spells it.
        tunable: whether it may change between two steps.
    """

    key: str
    meaning: str
    start: tuple[float, ...]
    unit: Unit
    text: str
    limits: Limits
    destinations: tuple[Destination, ...]
    tunable: bool


def open_parameters(part: RobotPart) -> list[OpenParameter]:
    """List the numbers of the experiment's file that can still be set in an exported part, in the file's order."""
    found: dict[str, list[Destination]] = {}
    worked_out = {f"controller.model.{name}" for name in Model.model_fields} if has_tissue_estimate(part) else set()
    for component in part.components:
        for key, destination in _numbers(part, component):
            if key not in worked_out:
                found.setdefault(key, []).append(destination)
        for attribute, (field, times) in component.numbers.items() if isinstance(component, FaultComponent) else ():
            found[f"{component.name}.{attribute}"] = [Destination(component.name, component.memory[field], times=times)]
    offered = [
        _parameter(part.experiment, key, tuple(found[key])) for key in sorted(found, key=_order) if key != START_KEY
    ]
    if START_KEY in found:
        meaning = "where the platform is at the start, at rest"
        metre = known_unit("m")
        assert metre is not None
        start = tuple(float(x) for x in part.start)
        offered.append(OpenParameter(START_KEY, meaning, start, metre, "m", NO_LIMITS, tuple(found[START_KEY]), False))
    return offered


def _order(key: str) -> tuple[int, int]:
    table, _, name = key.rpartition(".")
    first = _FIRST_KEYS.get(table, ())
    return (
        _TABLE_ORDER.index(table) if table in _TABLE_ORDER else 0,
        first.index(name) if name in first else len(first),
    )


def _parameter(experiment: Experiment, key: str, destinations: tuple[Destination, ...]) -> OpenParameter:
    table, _, attribute = key.rpartition(".")
    fault = fault_of(experiment, table)
    field = (fault_table_model(FAULT_KINDS[fault.kind]) if fault else _TABLE_MODELS[table]).model_fields[attribute]
    name = field.alias or attribute
    value = stated_values(experiment, table).get(name, field.default)
    text = name.removeprefix(f"{attribute}_").replace("_per_", "/").replace("per_", "1/").replace("_", ".")
    text = text if field.alias and known_unit(text) else "1"
    unit = known_unit(text)
    assert unit is not None
    start = tuple(float(x) for x in value) if isinstance(value, (tuple, list)) else (float(value),)
    above, at_least, below, at_most = (
        next((getattr(m, sign) for m in field.metadata if hasattr(m, sign)), None) for sign in ("gt", "ge", "lt", "le")
    )
    key = f"{table}.{name}"
    limits = above, at_least, below, at_most
    return OpenParameter(key, field.description or "", start, unit, text, limits, destinations, key in TUNABLE_PLACES)


Destinations = Iterator[tuple[str, Destination]]


def _numbers(part: RobotPart, component: NativeComponent) -> Destinations:
    """Yield each number of the experiment's file that is in a component's memory: its key and place."""
    name = component.name
    for memory in SETTING_MEMORIES:
        for field, source in memory.fields.items() if memory.component == name else ():
            path, numbers = TABLE_PATHS[source.table], MemoryPlace(name, memory.record, field).memory_of(component)
            shown = source.setting.exported and source.form != "i8"
            if shown and numbers is not None and _is_open(part, memory.record, path, source.name):
                yield f"{path}.{source.name}", Destination(name, numbers, source.divisor, source.times)
    if name == "body":
        yield from _body(part)
    if name == "plant":
        yield START_KEY, Destination("plant", component.memory[0:1]["x"][0, :3])


def _is_open(part: RobotPart, record: str, path: str, name: str) -> bool:
    """Whether a number can stay a parameter: the experiment sets it, and nothing is precomputed from it."""
    c, watched = part.experiment.controller, part.experiment.monitor
    table: Any = part.experiment
    for inner in path.split("."):
        table = getattr(table, inner, None)
    if getattr(table, name, None) is None:
        return False
    match record, name:
        case "law", "speed_limit":
            # a monitor without its own limit derives its limits from it
            return watched is None or watched.command_limit is not None or part.component("monitor") is None
        case "law", "reference":
            return part.experiment.reference is not None
        case "law", "trigger" | "trigger_time":
            return part.experiment.reference is not None and c.mode == "force_position"
        case "adaptive.schedule", _:
            return bool(c.force.schedule)
        case "adaptive.taps", _:
            return c.touch is not None and c.touch.force_learning > 0.0
    return True


def _body(part: RobotPart) -> Destinations:
    body = part.component("body")
    assert body is not None
    motions = body.pointers["motions"]
    for row, table in enumerate(part.experiment.contact.motions):
        for field, source in setting_fields(type(table)).items():
            if getattr(table, source.name) is not None:
                numbers = motions[row : row + 1][field].reshape(-1)
                # the last of the three numbers of a displacement is its amplitude
                there = numbers if source.form == "3f8" else numbers[-1:]
                yield f"{TABLE_PATHS[type(table)]}.{source.name}", Destination("body", there)


def has_tissue_estimate(part: RobotPart) -> bool:
    """Whether an exported part's controller estimates the tissue, which needs values precomputed in Python."""
    return part.component("controller") is not None and part.experiment.controller.tissue is not None


def stated_values(experiment: Experiment, table: str) -> Mapping[str, Any]:
    """Return the experiment's values in a table such as `controller.force`, or `fault_2` for the second [[fault]]."""
    values: Any = experiment.values
    if fault_of(experiment, table):
        return values["fault"][int(table.rpartition("_")[2]) - 1]
    for word in table.split(".") if table else ():
        values = values.get(word) if isinstance(values, Mapping) else None
    return values if isinstance(values, Mapping) else {}


def fixed_keys(part: RobotPart, offered: Sequence[OpenParameter]) -> list[str]:
    """Return the experiment's keys that affect an exported part and cannot be set any more."""
    open_ones = {parameter.key for parameter in offered}
    experiment = part.experiment
    keys: dict[str, None] = {}
    for component in part.components:
        fault = fault_of(experiment, component.name)
        if fault:
            stated = (f"{component.name}.{key}" for key in stated_values(experiment, component.name))
            keys |= dict.fromkeys((*stated, *related_keys(fault)))
        keys |= dict.fromkeys(key for key in _FIXED_KEYS.get(component.name, ()) if _is_stated_key(experiment, key))
    if has_tissue_estimate(part):
        keys["[controller.model]"] = None
    return ["cosim.tick_ms", *(key for key in keys if key not in open_ones)]


def _is_stated_key(experiment: Experiment, key: str) -> bool:
    table, _, name = key.strip("[]").rpartition(".")
    value = stated_values(experiment, table).get(name)
    return bool(value) or value == 0
