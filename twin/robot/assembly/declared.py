"""Tables that the robot's parts declare, and the memory place of each number."""

import math
from collections.abc import Mapping
from typing import NamedTuple

from twin.kernel.cosim.component import MemoryPlace
from twin.kernel.settings import FieldSource, Settings, Values, setting_fields
from twin.robot.controller.breath import Breath
from twin.robot.controller.compliance import Damping, FeedForwardModel
from twin.robot.controller.controller import Belief, Law
from twin.robot.controller.energy_tank import EnergyTank, Tank
from twin.robot.controller.pid import ForceLoop, PositionLoop, Processor
from twin.robot.controller.program import TASK_KINDS, Approach
from twin.robot.controller.schedule import Scheduling
from twin.robot.controller.task_controller import Computer, Touch
from twin.robot.controller.tissue import Sensing
from twin.robot.experiment.experiment import NEEDED_TABLES, OPTIONAL_TABLES
from twin.robot.experiment.schema import DeclaredTables, nested_tables
from twin.robot.mechanism.statics import G_ACCELERATION
from twin.robot.monitor.component import MonitorBelief
from twin.robot.monitor.limits import Monitor
from twin.robot.plant.contact_law import Contact
from twin.robot.plant.dynamics import PlantParameters, Robot, TrueRobot
from twin.robot.plant.encoder import Display

_ENCODER_KEYS = ("zero", "noise", "eccentricity", "eccentric_at")
_NEEDED_TABLES: dict[str, type[Settings]] = {
    "robot": Robot,
    "plant": TrueRobot,
    "contact": Contact,
    **NEEDED_TABLES,
    "controller": Computer,
}
_OPTIONAL_TABLES: dict[str, type[Settings]] = {
    "scale": Display,
    "reference": OPTIONAL_TABLES["reference"],
    "approach": Approach,
    "monitor": Monitor,
    **OPTIONAL_TABLES,
}
_TUNABLE_SOURCES: dict[str, FieldSource] = {}
TUNABLE_PLACES: dict[str, MemoryPlace] = {}
"""Memory places of the parameters that may change during a run, by key in the file."""


class SettingMemory(NamedTuple):
    """The place of an experiment's settings in a component's memory.

    Attributes:
        record: record in its memory, names of nested records joined by "."; "" for the memory itself.
        fields: setting that each field holds, by field name.
        broken_by: field changed by a fault, by kind of fault.
    """

    component: str
    record: str
    fields: Mapping[str, FieldSource]
    broken_by: Mapping[str, str] = {}


def _values_memory(component: str, record: str, values: type[Values]) -> SettingMemory:
    return SettingMemory(component, record, values.sources, values.broken_by)


def _monitor_belief_fields() -> dict[str, FieldSource]:
    """Return the setting of [robot] behind each field of the monitor's model, whatever [controller.model] has."""
    model = MonitorBelief.sources
    return {name: FieldSource(Robot, model[name].name if name in model else name) for name in MonitorBelief._fields}


def _shaft_fields(side: str) -> dict[str, FieldSource]:
    counts = FieldSource(TrueRobot, f"{side}_counts_per_turn", divisor=2.0 * math.pi)
    return {"counts_per_rad": counts} | {name: FieldSource(TrueRobot, f"{side}_{name}") for name in _ENCODER_KEYS}


SETTING_MEMORIES = (
    _values_memory("plant", "parameters", PlantParameters),
    SettingMemory("scale", "", {"resolution": FieldSource(Display, "resolution", times=G_ACCELERATION)}),
    SettingMemory("encoder", "motor", _shaft_fields("motor")),
    SettingMemory("encoder", "joint", _shaft_fields("joint")),
    _values_memory("estimator", "belief", Belief),
    _values_memory("controller", "law", Law),
    SettingMemory("controller", "force", setting_fields(ForceLoop, into="gains")),
    SettingMemory("controller", "position", setting_fields(PositionLoop)),
    _values_memory("controller", "adaptive.tissue", Sensing),
    _values_memory("controller", "adaptive.schedule", Scheduling),
    SettingMemory("controller", "adaptive.breath", setting_fields(Breath)),
    SettingMemory("controller", "adaptive.taps", setting_fields(Touch, into="taps")),
    _values_memory("controller", "forward", FeedForwardModel),
    SettingMemory("controller", "damper", setting_fields(Damping)),
    SettingMemory("controller", "machine", setting_fields(Touch)),
    _values_memory("tank", "tank", Tank),
    # the tank is full at the start
    SettingMemory("tank", "", {"level": FieldSource(EnergyTank, "size")}),
    SettingMemory("monitor", "belief", _monitor_belief_fields()),
)
"""All settings in memory, in component order."""

TABLE_PATHS: dict[type[Settings], str] = {
    table: path
    for name, model in {**_NEEDED_TABLES, **_OPTIONAL_TABLES}.items()
    for path, table in nested_tables(model, name).items()
}
TABLE_PATHS[Processor] = TABLE_PATHS[Computer]
"""Where the file has a table, `controller.force`, by its class."""


for _memory in SETTING_MEMORIES:
    for _field, _source in _memory.fields.items():
        if _source.setting.tunable:
            _key = f"{TABLE_PATHS[_source.table]}.{_source.setting.key(_source.name)}"
            # for a setting in two places the first one: the other is a copy that a schedule returns to
            TUNABLE_PLACES.setdefault(_key, MemoryPlace(_memory.component, _memory.record, _field))
            _TUNABLE_SOURCES.setdefault(_key, _source)
FAULT_PLACES = {
    kind: MemoryPlace(memory.component, memory.record, field)
    for memory in SETTING_MEMORIES
    for kind, field in memory.broken_by.items()
}
"""Memory place that a fault changes, by kind of fault."""
DECLARED_TABLES = DeclaredTables(_NEEDED_TABLES, _OPTIONAL_TABLES, _TUNABLE_SOURCES, TASK_KINDS)
"""The declared tables in the form that `twin.robot.experiment` takes."""
