"""Which numbers of an experiment's file stay open in what is built, and where its components keep them.

A number has a place in the memory of a component, which is its SI value, or that divided or multiplied by a constant:
so all that is derived of it is derived again when it is put there. What is not in these tables is fixed: it decides how
many ticks or phases there are, or which law holds, or something is worked out of it in Python.
"""

import math
from collections.abc import Iterator, Mapping
from typing import Any, NamedTuple

import numpy as np

from twin.controller.belief import Belief
from twin.experiment.contact import Breathing, Contact, Shift
from twin.experiment.experiment import Experiment
from twin.experiment.fault import table_of
from twin.experiment.fault_catalogue import CATALOGUE
from twin.experiment.quantity import Section
from twin.experiment.robot import Model, Plant, Robot
from twin.experiment.schema import Controller, Damping, EnergyTank, FeedForward, ForceLoop, PositionLoop, Scale, Touch
from twin.experiment.tissue import Breath, Tissue
from twin.monitor.belief import MonitorBelief
from twin.robot.gravity import G_ACCELERATION
from twin.runs.assembly.tunable import PLACES as TUNABLES
from twin.studies.build.adaptive import besides, senses
from twin.studies.build.fault_numbers import fault_numbers, fault_of
from twin.studies.build.part import RobotPart
from twin.units import Unit, known_unit

START = "start.p_B"
_TABLES: dict[str, type[Section]] = {
    "plant": Plant,
    "robot": Robot,
    "contact": Contact,
    "contact.breathing": Breathing,
    "contact.shift": Shift,
    "scale": Scale,
    "controller": Controller,
    "controller.model": Model,
    "controller.force": ForceLoop,
    "controller.position": PositionLoop,
    "controller.touch": Touch,
    "controller.feed_forward": FeedForward,
    "controller.damping": Damping,
    "controller.tissue": Tissue,
    "controller.breath": Breath,
    "controller.energy_tank": EnergyTank,
}

Limits = tuple[float | None, float | None, float | None, float | None]
UNLIMITED: Limits = (None, None, None, None)


class Destination(NamedTuple):
    """Where a number goes.

    Attributes:
        component: whose memory it is.
        memory: the numbers there, one for each value, or any number of the same.
        divisor, times: memory = SI value / divisor * times.
    """

    component: str
    memory: np.ndarray
    divisor: float = 1.0
    times: float = 1.0


class Parameter(NamedTuple):
    """A number of the experiment's file that stays open.

    Attributes:
        key: of the file, `plant.k_s_Nm_per_rad`.
        meaning: one phrase.
        start: its values.
        unit: of them; `text` as the file spells it.
        limits: above, at least, below, at most; None where there is none.
        destinations: where it goes.
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


def parameters(part: RobotPart) -> list[Parameter]:
    """All of them, in the order of the tables of the file."""
    found: dict[str, list[Destination]] = {}
    worked_out = {f"controller.model.{name}" for name in Model.model_fields} if senses(part) else set()
    for component in part.components:
        for key, destination in _OF.get(component.name, _nothing)(part, component.memory[0:1]):
            if key not in worked_out:
                found.setdefault(key, []).append(destination)
        fault = fault_of(part.experiment, component.name)
        for attribute, memory, times in fault_numbers(part.experiment, fault, component) if fault else ():
            found[f"{component.name}.{attribute}"] = [Destination(component.name, memory, times=times)]
    order = {table: n for n, table in enumerate(_TABLES)}
    keys = sorted((key for key in found if key != START), key=lambda key: order.get(key.rpartition(".")[0], 0))
    offered = [_parameter(part.experiment, key, tuple(found[key])) for key in keys]
    if START in found:
        meaning = "where the platform is at the start, at rest"
        metre = known_unit("m")
        assert metre is not None
        start = tuple(float(x) for x in part.start)
        offered.append(Parameter(START, meaning, start, metre, "m", UNLIMITED, tuple(found[START]), False))
    return offered


def _parameter(experiment: Experiment, key: str, destinations: tuple[Destination, ...]) -> Parameter:
    table, _, attribute = key.rpartition(".")
    fault = fault_of(experiment, table)
    field = (table_of(CATALOGUE[fault.kind]) if fault else _TABLES[table]).model_fields[attribute]
    name = field.alias or attribute
    value = said_in(experiment, table).get(name, field.default)
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
    return Parameter(key, field.description or "", start, unit, text, limits, destinations, key in TUNABLES)


Found = Iterator[tuple[str, Destination]]


def _nothing(part: RobotPart, memory: np.ndarray) -> Found:
    return iter(())


def _plant(part: RobotPart, memory: np.ndarray) -> Found:
    true, contact = memory["parameters"], part.experiment.contact
    for name in (
        "a", "b", "l_a", "l_b", "m_a", "m_b", "m_p", "I_r", "b_j", "k_s", "N", "eta", "backlash", "eta_rate",
        "belt_compliance", "joint_friction", "joint_presliding", "spring_hysteresis", "spring_stop", "joint_lower",
        "joint_upper", "stop", "mounting_tilt", "mounting_tilt_x", "head",
    ):  # fmt: skip
        if getattr(part.experiment.plant, name) is not None:
            yield f"plant.{name}", Destination("plant", true[name])
    names = {
        "height": "z_s", "tilt": "tilt", "tilt_x": "tilt_x", "stiffness": "K", "friction": "mu", "bristle": "sigma_0",
        "bristle_damping": "sigma_1", **{name: name for name in contact.law_constants},
    }  # fmt: skip
    if contact.radius is not None:
        names["radius"] = "radius"
    for name, own in names.items():
        yield f"contact.{name}", Destination("plant", true[own])
    yield START, Destination("plant", memory["x"][0, :3])


def _body(part: RobotPart, memory: np.ndarray) -> Found:
    body = part.component("body")
    assert body is not None
    contact, motions = part.experiment.contact, iter(body.pointers["motions"])
    for table, way in ((contact.breathing, "amplitude"), (contact.shift, "by")):
        if table is None:
            continue
        name, motion = ("breathing", next(motions)) if way == "amplitude" else ("shift", next(motions))
        displacement = motion["displacement"]
        yield f"contact.{name}.{way}", Destination("body", displacement[2:] if way == "amplitude" else displacement)
        other = "rate" if name == "breathing" else "rise"
        for key, field in (("start", "onset"), (other, other), ("end", "end")):
            if getattr(table, key) is not None:
                # a number of a record as an array of one
                place = np.ndarray((1,), buffer=motion, offset=motion.dtype.fields[field][1])
                yield f"contact.{name}.{key}", Destination("body", place)


def _scale(part: RobotPart, memory: np.ndarray) -> Found:
    yield "scale.resolution", Destination("scale", memory["resolution"], times=G_ACCELERATION)


def _encoder(part: RobotPart, memory: np.ndarray) -> Found:
    for side in ("motor", "joint"):
        yield f"plant.{side}_counts_per_turn", Destination("encoder", memory[side]["counts_per_rad"], 2 * math.pi)
        yield f"plant.{side}_zero", Destination("encoder", memory[side]["zero"])
        for name in ("noise", "eccentricity", "eccentric_at"):
            yield f"plant.{side}_{name}", Destination("encoder", memory[side][name])


_COUNTS = {"motor_counts": "motor_counts_per_turn", "joint_counts": "joint_counts_per_turn"}


def _estimator(part: RobotPart, memory: np.ndarray) -> Found:
    belief = memory["belief"]
    for name in Belief._fields:
        key = "controller.dead_zone" if name == "backlash" else f"controller.model.{_COUNTS.get(name, name)}"
        yield key, Destination("estimator", belief[name])


def _controller(part: RobotPart, memory: np.ndarray) -> Found:
    c, law = part.experiment.controller, memory["law"]
    yield "controller.model.N", Destination("controller", law["N"])
    watched = part.experiment.monitor
    # the limits of a monitor are worked out of it where it has no limit of its own
    if watched is None or watched.command_limit is not None or part.component("monitor") is None:
        yield "controller.speed_limit", Destination("controller", law["omega_max"])
    yield "controller.force.limit", Destination("controller", law["dp_z_max"])
    yield "controller.force.filter", Destination("controller", law["corner"])
    for loop in ("force", "position"):
        for name in ("kp", "ki", "kd"):
            yield f"controller.{loop}.{name}", Destination("controller", memory[loop][name])
        yield f"controller.{loop}.derivative_filter", Destination("controller", memory[loop]["derivative_corner"])
    if c.tissue is not None:
        yield from ((key, Destination("controller", to, times=n)) for key, to, n in besides(c, memory["adaptive"]))
    if part.experiment.reference is not None:
        led = {"reference": "F_z_ref", "trigger": "trigger_force", "trigger_time": "trigger_time"}
        if c.mode != "force_position":
            led = {"reference": "F_z_ref"}
        for name, own in led.items():
            if getattr(c.force, name) is not None:
                yield f"controller.force.{name}", Destination("controller", law[own])
        return
    forward, machine = memory["forward"], memory["machine"]
    yield "controller.model.k_s", Destination("controller", forward["k_s"])
    yield "controller.model.eta", Destination("controller", forward["eta"])
    yield "controller.feed_forward.friction", Destination("controller", forward["mu"])
    yield "controller.feed_forward.lag", Destination("controller", forward["lag"])
    yield "controller.damping.gain", Destination("controller", memory["damper"]["gain"])
    yield "controller.damping.corner", Destination("controller", memory["damper"]["corner"])
    yield "controller.touch.patience", Destination("controller", machine["patience"])
    yield "controller.touch.turn", Destination("controller", machine["t_turn"])
    yield "controller.touch.learning", Destination("controller", machine["learning"])


def _tank(part: RobotPart, memory: np.ndarray) -> Found:
    tank = memory["tank"]
    for name in ("size", "horizon", "touch", "bias", *(["release"] if np.isfinite(tank["release"]).all() else [])):
        yield f"controller.energy_tank.{name}", Destination("tank", tank[name])
    yield "controller.energy_tank.size", Destination("tank", memory["level"])  # at the start it is full
    for name in ("k_s", "N", "eta"):
        yield f"controller.model.{name}", Destination("tank", tank[name])


def _monitor(part: RobotPart, memory: np.ndarray) -> Found:
    for name in MonitorBelief._fields:
        yield f"robot.{_COUNTS.get(name, name)}", Destination("monitor", memory["belief"][name])


_OF = {
    "plant": _plant,
    "body": _body,
    "scale": _scale,
    "encoder": _encoder,
    "estimator": _estimator,
    "controller": _controller,
    "tank": _tank,
    "monitor": _monitor,
}


def said_in(experiment: Experiment, table: str) -> Mapping[str, Any]:
    """What the experiment says in `table`, `controller.force`, or `fault_2` for the second [[fault]]."""
    values: Any = experiment.values
    if fault_of(experiment, table):
        return values["fault"][int(table.rpartition("_")[2]) - 1]
    for word in table.split(".") if table else ():
        values = values.get(word) if isinstance(values, Mapping) else None
    return values if isinstance(values, Mapping) else {}
