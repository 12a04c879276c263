"""The tables that the robot's parts declare, and the place of each number in their memory."""

import math
from collections.abc import Mapping
from typing import NamedTuple

from twin.kernel.cosim.component import MemoryPlace
from twin.kernel.settings import FieldSource, Settings, Values, taken
from twin.robot.controller.breath import Breath
from twin.robot.controller.compliance import Believed, Damping
from twin.robot.controller.controller import Belief, Law
from twin.robot.controller.energy_tank import EnergyTank, Tank
from twin.robot.controller.pid import ForceLoop, PositionLoop, Processor
from twin.robot.controller.program import TASKS, Approach
from twin.robot.controller.schedule import Scheduling
from twin.robot.controller.task_controller import Computer, Touch
from twin.robot.controller.tissue import Sensing
from twin.robot.experiment.experiment import NEEDED, OPTIONAL
from twin.robot.experiment.schema import Changeable, Declared, nested
from twin.robot.mechanism.statics import G_ACCELERATION
from twin.robot.monitor.component import MonitorBelief
from twin.robot.monitor.limits import Monitor
from twin.robot.plant.contact_law import Contact
from twin.robot.plant.dynamics import PlantParameters, Robot, TrueRobot
from twin.robot.plant.encoder import Display

_ENCODERS = ("zero", "noise", "eccentricity", "eccentric_at")
_NEEDED: dict[str, type[Settings]] = {
    "robot": Robot,
    "plant": TrueRobot,
    "contact": Contact,
    **NEEDED,
    "controller": Computer,
}
_OPTIONAL: dict[str, type[Settings]] = {
    "scale": Display,
    "reference": OPTIONAL["reference"],
    "approach": Approach,
    "monitor": Monitor,
    **OPTIONAL,
}
_TUNABLE: dict[str, tuple[MemoryPlace, FieldSource]] = {}


class Memory(NamedTuple):
    """Where a component keeps settings.

    Attributes:
        component: its name.
        record: in its memory, the names of records in records joined by "."; "" the memory itself.
        fields: those of the record that hold settings.
        broken_by: the field that a kind of fault changes, by the kind.
    """

    component: str
    record: str
    fields: Mapping[str, FieldSource]
    broken_by: Mapping[str, str] = {}


def _values(component: str, record: str, values: type[Values]) -> Memory:
    return Memory(component, record, values.sources, values.broken_by)


def _robot() -> dict[str, FieldSource]:
    """The monitor believes what [robot] says, whatever [controller.model] does."""
    model = MonitorBelief.sources
    return {name: FieldSource(Robot, model[name].name if name in model else name) for name in MonitorBelief._fields}


def _shaft(side: str) -> dict[str, FieldSource]:
    counts = FieldSource(TrueRobot, f"{side}_counts_per_turn", divisor=2.0 * math.pi)
    return {"counts_per_rad": counts} | {name: FieldSource(TrueRobot, f"{side}_{name}") for name in _ENCODERS}


MEMORIES = (
    _values("plant", "parameters", PlantParameters),
    Memory("scale", "", {"resolution": FieldSource(Display, "resolution", times=G_ACCELERATION)}),
    Memory("encoder", "motor", _shaft("motor")),
    Memory("encoder", "joint", _shaft("joint")),
    _values("estimator", "belief", Belief),
    _values("controller", "law", Law),
    Memory("controller", "force", taken(ForceLoop, into="gains")),
    Memory("controller", "position", taken(PositionLoop)),
    _values("controller", "adaptive.tissue", Sensing),
    _values("controller", "adaptive.schedule", Scheduling),
    Memory("controller", "adaptive.breath", taken(Breath)),
    Memory("controller", "adaptive.taps", taken(Touch, into="taps")),
    _values("controller", "forward", Believed),
    Memory("controller", "damper", taken(Damping)),
    Memory("controller", "machine", taken(Touch)),
    _values("tank", "tank", Tank),
    # at the start it is full
    Memory("tank", "", {"level": FieldSource(EnergyTank, "size")}),
    Memory("monitor", "belief", _robot()),
)
"""In the order in which the components look at them."""

PATHS: dict[type[Settings], str] = {
    table: path for name, model in {**_NEEDED, **_OPTIONAL}.items() for path, table in nested(model, name).items()
}
PATHS[Processor] = PATHS[Computer]
"""Where the file has a table, `controller.force`, by its class."""


def key_of(source: FieldSource) -> str:
    """The key in the file of what a field holds, `controller.force.kp_mm_per_N`."""
    return f"{PATHS[source.table]}.{source.setting.key(source.name)}"


for _memory in MEMORIES:
    for _field, _source in _memory.fields.items():
        if _source.setting.tunable:
            # of one that lies in two places the first: the other one is a copy that a schedule goes back to
            _TUNABLE.setdefault(key_of(_source), (MemoryPlace(_memory.component, _memory.record, _field), _source))
PLACES = {key: place for key, (place, _) in _TUNABLE.items()}
"""Where the numbers lie that may change while the robot runs, by their keys in the file."""
BROKEN = {
    kind: MemoryPlace(memory.component, memory.record, field)
    for memory in MEMORIES
    for kind, field in memory.broken_by.items()
}
"""Where a kind of fault changes a number."""
_CHANGEABLE = {key: Changeable(source.table, source.name) for key, (_, source) in _TUNABLE.items()}
DECLARED = Declared(_NEEDED, _OPTIONAL, _CHANGEABLE, TASKS)
"""As `twin.robot.experiment` is handed it."""
