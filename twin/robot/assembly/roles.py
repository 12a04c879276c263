"""Parts of the robot that may be of another make: the ports that each has to have, and how one is made.

An FMU and a Python class take their place in the same way; whether a part is twin's own nobody downstream can tell but
by its name.
"""

import inspect
from collections.abc import Callable, Mapping, Sequence
from contextlib import suppress
from dataclasses import dataclass
from typing import Any, NamedTuple

from twin.kernel.cosim.component import Component
from twin.kernel.cosim.port import Port
from twin.kernel.cosim.python_class import NamedPorts, PythonComponent, PythonSource, Wanted, made, wanted_of
from twin.kernel.errors import InputRefused
from twin.kernel.fmi.calls import announced
from twin.kernel.fmi.description import FmuDescription
from twin.kernel.fmi.setting import told
from twin.robot.assembly.drives import refuse_other_file
from twin.robot.controller.controller import ESTIMATOR_INPUTS, ESTIMATOR_OUTPUTS, P_REF_B
from twin.robot.controller.task_controller import TASK_INPUTS, TASK_OUTPUTS
from twin.robot.drive.sampled import SampledFmu, port_of, sampled_fmu
from twin.robot.experiment.drive_files import StandIn
from twin.robot.experiment.experiment import Experiment
from twin.robot.monitor.component import INPUTS as MONITOR_INPUTS
from twin.robot.monitor.component import OUTPUTS as MONITOR_OUTPUTS
from twin.robot.plant.contact_law import OUTPUTS as BODY_OUTPUTS
from twin.robot.plant.encoder import SCALE_INPUTS, SCALE_OUTPUTS


class Contract(NamedTuple):
    """What a part of the robot may take and give.

    Attributes:
        inputs: any of them, none is forced on it.
        outputs: any of them besides those that are required.
        required: outputs by their names.
    """

    inputs: tuple[Port, ...]
    outputs: tuple[Port, ...]
    required: tuple[str, ...]


CONTRACTS = {
    "body": Contract((), BODY_OUTPUTS, ("s_B", "v_s_B")),
    "estimator": Contract(ESTIMATOR_INPUTS, ESTIMATOR_OUTPUTS, ("p_B", "J", "F_ee_B")),
    "controller": Contract((*TASK_INPUTS, P_REF_B), TASK_OUTPUTS, ("omega_ref",)),
    "monitor": Contract(MONITOR_INPUTS, MONITOR_OUTPUTS, ("omega_ref", "tripped", "power")),
    "scale": Contract(SCALE_INPUTS, SCALE_OUTPUTS, ("F_z",)),
}
"""By the part's name: that of its row in the robot's table, of its component and of its table in an experiment."""


@dataclass(frozen=True)
class OtherPart:
    """A part of another make, checked as far as that goes before it is made.

    Attributes:
        role: of `CONTRACTS`.
        label: what an error calls it.
        inputs, outputs: ports that it has.
        make: it, by the tick (s), its period in ticks and the last tick of the run.
        sha256: of the FMU, or of the Python source; "" where there is no file.
        facts: what a recording says of it besides.
    """

    role: str
    label: str
    inputs: tuple[Port, ...]
    outputs: tuple[Port, ...]
    make: Callable[[float, int, int], Component]
    sha256: str
    facts: Mapping[str, Any]
    fmu: FmuDescription | None = None

    @property
    def sentence(self) -> str:
        """What it is, for whoever reads a run."""
        own = "twin's own, which has the law of the paper," if self.role == "controller" else "twin's own"
        return f"{self.role}: {self.label} (sha256 {self.sha256[:12]}); {own} did not run"


def other_part(role: str, table: StandIn) -> OtherPart:
    """The part that [role] of an experiment names; of a Python class the file has been run.

    Raises:
        InputRefused: file, hash, mapping, ports or parameters are not right.
    """
    return _fmu_part(role, table) if table.fmu is not None else _class_part(role, table)


def other_parts(experiment: Experiment) -> dict[str, OtherPart]:
    """All parts of another make of an experiment, by their names; none of what a study has taken out of it.

    Raises:
        InputRefused: see `other_part`.
    """
    gone = {role for role in ("monitor", "scale") if getattr(experiment, role) is None}
    return {role: other_part(role, table) for role, table in experiment.stand_ins.items() if role not in gone}


def digest(role: str, table: StandIn) -> str:
    """SHA-256 of the part that [role] names; nothing of it is run.

    Raises:
        InputRefused: no such file, not the one that is pinned, an FMU that does not fit, or no Python.
    """
    if table.fmu is not None:
        return _fmu_part(role, table).sha256
    return _source(table).sha256


def given_part(role: str, given: Any) -> OtherPart:
    """The part that a program hands over as a class, or as an instance of one.

    Raises:
        InputRefused: there is no such part, or its ports are not right.
    """
    kind = given if isinstance(given, type) else type(given)
    contract = CONTRACTS[role]
    wanted = wanted_of(kind.__name__, given, *contract)
    make = _maker(role, kind.__name__, lambda: made(kind.__name__, kind, {}) if given is kind else given, wanted)
    file = None
    # of a class that was typed in, or is compiled
    with suppress(TypeError, AttributeError):
        file = inspect.getsourcefile(kind)
    return OtherPart(role, kind.__name__, wanted[0].ports, wanted[1].ports, make, "", {"file": file})


def refuse_other_parts(experiment: Experiment, asker: str, roles: Sequence[str]) -> None:
    """For studies that know twin's own parts only.

    Args:
        asker: the study, as the subject of a sentence.
        roles: of the parts that it knows.

    Raises:
        InputRefused: one of them is of another make.
    """
    for role in roles:
        if role in experiment.stand_ins:
            raise InputRefused(
                f"{experiment.name}: its {role} is {experiment.stand_ins[role].label}; {asker} knows the law of twin's "
                f"own {role} only. Remove fmu or python from [{role}]"
            )


def _fmu_part(role: str, table: StandIn) -> OtherPart:
    contract = CONTRACTS[role]
    plan = sampled_fmu(
        table.file, role, (contract.inputs, contract.outputs), contract.required, (table.inputs, table.outputs),
        table.parameters, table.tolerance,
    )  # fmt: skip
    fmu = plan.description
    refuse_other_file(table.file, fmu.sha256, table.sha256)
    facts = {
        "file": fmu.path.name,
        "sha256": fmu.sha256,
        "model": fmu.model.modelName,
        "fmi": fmu.model.fmiVersion,
        "generation_tool": fmu.model.generationTool,
        "tolerance": plan.tolerance,
        "set": {variable.name: told(value) for variable, value in plan.settings},
        "mapped": [*_mapped(plan, plan.inputs, "input", "<-"), *_mapped(plan, plan.outputs, "output", "->")],
    }

    def make(tick: float, period: int, ticks: int) -> Component:
        return plan.component(role, tick, period, ticks)

    return OtherPart(role, fmu.path.name, plan.inputs, plan.outputs, make, fmu.sha256, facts, fmu)


def _mapped(plan: SampledFmu, ports: Sequence[Port], side: str, arrow: str) -> list[str]:
    """A line for each port: `p_B <- p_x, p_y, p_z [mm]`."""
    lines = []
    for port in ports:
        mine = [b for b in plan.bindings if b.role.causality == side and port_of(b) == port.name]
        unit = mine[0].variable.unit or "unit not stated"
        lines.append(f"{port.name} {arrow} {', '.join(b.said for b in mine)} [{unit}]")
    return lines


def _class_part(role: str, table: StandIn) -> OtherPart:
    source = _source(table)
    # nobody has said how long that takes: whoever watches is told who is at work
    with announced(source.file.name, role, "its import"):
        kind = source.class_of(table.class_name)
    contract = CONTRACTS[role]
    wanted = wanted_of(table.label, kind, *contract)
    facts = {
        "file": source.file.name,
        "class": table.class_name,
        "sha256": source.sha256,
        "set": dict(table.parameters),
        "mapped": [
            f"{port.name} {arrow} [{side.units[port.name]}]"
            for side, arrow in zip(wanted, ("<-", "->"), strict=True)
            for port in side.ports
        ],
    }

    def model() -> Any:
        with announced(source.file.name, role, "its making"):
            return made(table.label, kind, table.parameters)

    make = _maker(role, table.label, model, wanted)
    return OtherPart(role, table.label, wanted[0].ports, wanted[1].ports, make, source.sha256, facts)


def _maker(
    role: str, label: str, model: Callable[[], Any], wanted: tuple[Wanted, Wanted]
) -> Callable[[float, int, int], Component]:
    return lambda tick, period, ticks: PythonComponent(role, NamedPorts(model(), *wanted), period, label=label)


def _source(table: StandIn) -> PythonSource:
    source = PythonSource(table.file)
    refuse_other_file(table.file, source.sha256, table.sha256)
    return source
