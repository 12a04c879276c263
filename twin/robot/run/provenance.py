"""Where a recording comes from."""

import json
from pathlib import Path
from typing import Any

from twin.kernel.fmi.setting import FILE, told
from twin.kernel.recording.recorder import versions
from twin.robot.assembly.assemble import Assembly
from twin.robot.assembly.drives import DrivePlan
from twin.robot.controller.program import PhaseKind
from twin.robot.experiment.experiment import Experiment
from twin.robot.experiment.source import KEPT, NAMING


def provenance(experiment: Experiment, assembly: Assembly) -> dict[str, dict[str, str]]:
    """What a recording says of its origin; nothing in it depends on when, where or by whom it was made."""
    fmus = {
        f"{name}{'.' * bool(part)}{part}": json.dumps(
            {
                "file": fmu.path.name,
                "sha256": fmu.sha256,
                **({"compiled_with": fmu.compiler} if fmu.compiler else {}),
                "model": fmu.model.modelName,
                "fmi": fmu.model.fmiVersion,
                "generation_tool": fmu.model.generationTool,
                "kind": fmu.kind,
                "solver": solver.method if (solver := plan.solver(part)) else None,
                "solver_step": solver.step if solver else None,
                "tolerance": plan.tolerance(part),
                "stop_time": experiment.duration_ticks * experiment.cosim.tick,
                "set": {variable.name: told(value) for variable, value in plan.settings[part]},
                "mapped": [str(binding) for binding in plan.bindings],
            }
        )
        for name, plan in driven(assembly)
        for part, fmu in plan.parts.items()
    }
    fmus |= {role: json.dumps(part.facts) for role, part in assembly.others.items() if part.fmu}
    classes = {role: json.dumps(part.facts) for role, part in assembly.others.items() if not part.fmu}
    values = named_files(experiment.values)
    if "controller" in assembly.substituted:
        # gains of a law that did not run
        values["controller"] = {k: v for k, v in values["controller"].items() if k in KEPT["controller"]}
    return {
        "experiment": {"name": experiment.name, "title": experiment.title, "values": json.dumps(values)},
        # sorted: the same experiment may be spread over files in many ways
        "origins": dict(sorted(experiment.origins.items())),
        "fmu": fmus,
        **({"python": classes} if classes else {}),
        **({"part": {role: part.sentence for role, part in assembly.others.items()}} if assembly.others else {}),
        **({"substituted": assembly.substituted} if assembly.substituted else {}),
        **({"phases": {str(kind.value): kind.phrase for kind in PhaseKind}} if experiment.tasks else {}),
        "versions": versions(),
    }


def driven(assembly: Assembly) -> list[tuple[str, DrivePlan]]:
    """(`drive_1`, its plan) and so on of the joints that the experiment's own drives move."""
    if "drive" in assembly.substituted:
        return []
    named = [(f"drive_{number}", plan) for number, plan in enumerate(assembly.drives, start=1)]
    return [(name, plan) for name, plan in named if name not in assembly.substituted]


def named_files(values: dict[str, Any]) -> dict[str, Any]:
    """`values` with FMUs, Python and other files by name only: where they lie on this machine is nobody's business."""
    return {key: _named(key, value) for key, value in values.items()}


def _named(key: str, value: Any) -> Any:
    if isinstance(value, dict):
        return named_files(value)
    if isinstance(value, (list, tuple)):
        return [_named("", v) for v in value]
    if isinstance(value, str) and value.startswith(FILE):
        return FILE + Path(value.removeprefix(FILE)).name
    return Path(value).name if key in NAMING else value
