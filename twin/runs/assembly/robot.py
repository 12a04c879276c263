"""The robot as one table: its components in the order of a tick, and where each of their inputs comes from.

A row may stand for no component at all (an experiment without a scale), for one, or for three (a drive for each
joint). Its inputs are those that its components have: a plant on a body that does not move has no `s_B`. Values are
joined in order, so three drives of one axis and one drive of three axes are wired alike; one value feeds many.
"""

from collections.abc import Mapping
from typing import NamedTuple

from twin.cosim.component import Component
from twin.cosim.system import End, Feeds, ends
from twin.errors import InputRefused
from twin.runs.assembly import computer, mechanics
from twin.runs.assembly.build import Parts, joint_drives

Source = tuple[str, str]


class Row(NamedTuple):
    """Components of the robot.

    Attributes:
        name: of the row, and of its component if there is one.
        parts: what makes its components, if the experiment has any.
        inputs: by port (row, port), where it comes from; of several the first one whose row has components.
    """

    name: str
    parts: Parts
    inputs: Mapping[str, tuple[Source, ...]]


def _row(name: str, parts: Parts, **inputs: str | tuple[str, ...]) -> Row:
    """A row with its sources as "row.port"."""
    told = {port: (source,) if isinstance(source, str) else source for port, source in inputs.items()}
    return Row(name, parts, {port: tuple(map(_source, sources)) for port, sources in told.items()})


def _source(text: str) -> Source:
    row, _, port = text.partition(".")
    return row, port


COMMAND = ("bus.omega_ref", "monitor.omega_ref", "delay.omega_ref", "tank.omega_ref", "controller.omega_ref")
"""What the drives are told: the last word on the way from the controller."""
POWER = ("bus.power", "monitor.power")
"""Whether they may have power."""

ROBOT = (
    _row("body", mechanics.body),
    _row("latency", mechanics.latency, theta_m="drive.theta_m", theta_l="plant.theta_l"),
    _row(
        "encoder", mechanics.encoder,
        theta_m=("latency.theta_m", "drive.theta_m"), theta_l=("latency.theta_l", "plant.theta_l"),
    ),
    _row("estimator", computer.estimators, count_m="encoder.count_m", count_l="encoder.count_l"),
    _row("reference", computer.references),
    _row(
        "controller", computer.controllers,
        p_ref_B="reference.p_ref_B",
        p_B="estimator.p_B", J="estimator.J", F_ee_B="estimator.F_ee_B", tau_l="estimator.tau_l",
        share="tank.share",
    ),
    _row(
        "tank", computer.tanks,
        omega_ref=COMMAND[4:], p_B="estimator.p_B", J="estimator.J", F_ee_B="estimator.F_ee_B", valid="estimator.valid",
        sample="encoder.sample",
    ),
    _row("delay", computer.delays, omega_ref=COMMAND[3:]),
    _row(
        "monitor", computer.monitors,
        omega_ref=COMMAND[2:], count_m="encoder.count_m", count_l="encoder.count_l", sample="encoder.sample",
    ),
    _row("bus", computer.buses, omega_ref=COMMAND[1:], power=POWER[1:]),
    _row("scale", mechanics.scale, F_ee_B="plant.F_ee_B"),
    _row("drive", joint_drives, omega_ref=COMMAND, tau_load="plant.tau_load", enable=POWER),
    _row(
        "plant", mechanics.plant,
        theta_m="drive.theta_m", theta_m_start="drive.theta_m", s_B="body.s_B", v_s_B="body.v_s_B",
    ),
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
            there = [source for source in sources if made[source[0]]]
            if targets and there:
                feeds.update(zip(targets, _values(there[0], made, targets), strict=True))
    return feeds


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
