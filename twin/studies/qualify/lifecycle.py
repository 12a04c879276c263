"""Whether each FMU of a drive can be reset, and its state saved and restored: FMI functions no experiment needs."""

from collections.abc import Callable
from dataclasses import asdict

import numpy as np

from twin.kernel.errors import TwinError
from twin.kernel.fmi.component import opened
from twin.kernel.fmi.description import FmuDescription
from twin.kernel.fmi.instance import Instance
from twin.kernel.fmi.setting import Setting, Setup
from twin.kernel.fmi.unpacked import unpacked
from twin.kernel.fmi.variable import Variable
from twin.kernel.process.guard import JobEnded, JobEndedLoading, guarded
from twin.kernel.process.reporter import Reporter
from twin.robot.assembly.drives import DrivePlan, belongs, planned
from twin.robot.experiment.schema import Drive
from twin.studies.qualify.definitions import LOAD_IN_USE, SPEED_IN_USE, TICK, Check, Finding, judged

JOB = "twin.studies.qualify.lifecycle:examined"
TICKS = 50
"""Long enough for every sampled loop inside to have come round."""
SETUP = Setup(stop=2 * TICKS * TICK, step=TICK)
SHARE_OF_LIMIT = 0.1
"""Of the velocity loop's limit, as the command of a drive that takes no speed."""


def lifecycle_findings(plan: DrivePlan, apart: bool) -> list[Finding]:
    """Checks `reset` and `state` of every FMU by itself, its inputs held.

    Args:
        plan: the drive.
        apart: each in a process of its own: an FMU that crashes there costs that check, and nothing else.

    Raises:
        InputRefused: an FMU cannot be loaded or initialised.
    """
    return [_apart(plan, name) if apart else _told(name, plan) for name in TRIED]


def examined(reporter: Reporter, table: Drive, name: str) -> dict[str, str]:
    """Fields of a check of the drive of `table`; a job of the guard."""
    return asdict(_told(name, planned(table)))


def _apart(plan: DrivePlan, name: str) -> Check:
    try:
        return Check(**guarded(JOB, {"table": plan.table, "name": name}))
    except (JobEnded, JobEndedLoading) as failure:
        return judged(name, False, str(failure), otherwise="note")


def _told(name: str, plan: DrivePlan) -> Check:
    problems = []
    for part, description in plan.parts.items():
        inputs, outputs = _excitation(plan, part), _watched(plan, part, description)
        folder = unpacked(description.path, description.sha256)
        instance = opened(part or "drive", description, folder, plan.settings[part], inputs, SETUP)
        try:
            problem = TRIED[name](instance, inputs, outputs)
        except TwinError as refusal:
            problem = str(refusal)
        finally:
            instance.close()
        if problem:
            problems.append(f"{part}: {problem}" if part else problem)
    return judged(name, not problems, "; ".join(problems) or "bit for bit", otherwise="note")


def _reset(instance: Instance, inputs: list[Setting], outputs: list[Variable]) -> str:
    """What is wrong with its reset; empty if nothing is."""
    first = _exercised(instance, inputs, outputs)
    instance.reset()
    return "" if np.array_equal(first, _exercised(instance, inputs, outputs)) else "a run after reset is another one"


def _state(instance: Instance, inputs: list[Setting], outputs: list[Variable]) -> str:
    """What is wrong with saving and restoring its state; empty if nothing is."""
    if not instance.description.interface.canGetAndSetFMUstate:
        return "not offered"
    _exercised(instance, inputs, outputs)
    state = instance.saved_state()
    onward = _exercised(instance, inputs, outputs, TICKS)
    instance.restore(state)
    again = _exercised(instance, inputs, outputs, TICKS)
    return "" if np.array_equal(onward, again) else "it goes on differently from a restored state"


TRIED: dict[str, Callable[[Instance, list[Setting], list[Variable]], str]] = {"reset": _reset, "state": _state}


def _exercised(instance: Instance, inputs: list[Setting], outputs: list[Variable], first: int = 0) -> np.ndarray:
    """Outputs (ticks, values) over `TICKS` steps from tick `first` on."""
    rows = []
    for k in range(first, first + TICKS):
        instance.write(inputs)
        instance.advance(k * TICK, TICK)
        rows.append(instance.read(outputs))
    return np.array(rows)


def _excitation(plan: DrivePlan, part: str) -> list[Setting]:
    """Held values, in the FMU's own units, of those inputs of `part` that the drive contract feeds."""
    loop = plan.table.velocity_loop
    wanted = {
        "omega_ref": SPEED_IN_USE,
        "tau_load": LOAD_IN_USE,
        "command": SHARE_OF_LIMIT * loop.limit if loop else 0.0,
    }
    return [
        (b.variable, (wanted[b.port.name] - b.offset) / b.gain)
        for b in plan.bindings
        if b.port.name in wanted and belongs(part, b.name) and not b.variable.clocks
    ]


def _watched(plan: DrivePlan, part: str, description: FmuDescription) -> list[Variable]:
    """The outputs of `part`, and whatever else of it plays a role."""
    roles = [b.variable for b in plan.bindings if b.role.causality == "output" and belongs(part, b.name)]
    # what a clock updates can only be read while that ticks
    return [v for v in {v.name: v for v in (*roles, *description.offered("output"))}.values() if not v.clocks]
