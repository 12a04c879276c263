"""What no table can see alone: whether the tables of an experiment agree with one another."""

from collections.abc import Collection, Mapping
from typing import Any

from twin.experiment.monitor import contradictions
from twin.experiment.reach import geometry_of, reference_mistakes
from twin.experiment.task import Task
from twin.experiment.task_checks import Situation, task_mistakes
from twin.experiment.true_parameters import plant_parameters
from twin.monitor.belief import Belief


def disagreements(checked: dict[str, Any], tasks: Mapping[int, Task], named: Collection[str]) -> list[str]:
    """Every way in which the tables that are right by themselves do not fit together, one sentence each.

    Args:
        checked: tables by name, those that are right. tasks: by number, likewise.
        named: what the file has, right or not.
    """
    mistakes = _of_modes(checked, named)
    models = [checked["plant"]] if "plant" in checked else []
    models += [checked["controller"].model] if "controller" in checked else []
    geometries = tuple(geometry_of(model) for model in models)
    if "reference" in checked:
        mistakes += reference_mistakes(checked["reference"], geometries)
    if "monitor" in checked and {"robot", "controller"} <= checked.keys():
        computer = checked["controller"]
        mistakes += contradictions(
            checked["monitor"], monitor_belief(checked["robot"]), computer.period, computer.speed_limit
        )
    if tasks and {"plant", "contact", "approach", "controller", "head"} <= checked.keys():
        monitor = checked.get("monitor")
        situation = Situation(
            plant_parameters(checked["plant"], checked["contact"]),
            geometries,
            checked["approach"],
            checked["controller"],
            monitor if monitor is not None and monitor.enabled else None,
        )
        mistakes += task_mistakes(situation, tasks, checked["head"].duration)
    return mistakes


def monitor_belief(robot: Any) -> Belief:
    """What the safety monitor believes: the robot as [robot] has it, whatever [controller.model] says."""
    return Belief(**{name: getattr(robot, _NAMES.get(name, name)) for name in Belief._fields})


_NAMES = {"motor_counts": "motor_counts_per_turn", "joint_counts": "joint_counts_per_turn"}


def _of_modes(checked: dict[str, Any], named: Collection[str]) -> list[str]:
    """Way points or tasks, and what each of them needs."""
    has_tasks = "task" in named
    if has_tasks == ("reference" in named):
        return ["expected either [reference] with way points or [[task]] tables" + (", not both" if has_tasks else "")]
    if "controller" not in checked:
        return []
    computer = checked["controller"]
    force = {
        "reference_N": computer.force.reference,
        "trigger_N": computer.force.trigger,
        "trigger_time_s": computer.force.trigger_time,
    }
    if not has_tasks:
        missing = computer.mode == "force_position" and computer.force.reference is None
        return ["[controller.force] missing key 'reference_N'"] if missing else []
    told = [] if "approach" in named else ["missing table [approach], which tasks need"]
    for name in ("touch", "feed_forward"):
        if getattr(computer, name) is None:
            told.append(f"missing table [controller.{name}], which tasks need")
    if computer.mode != "force_position":
        told.append(f'[controller] mode = "{computer.mode}": tasks press; expected "force_position"')
    told += [
        f"[controller.force] {key}: tasks have a force of their own and feel contact by [controller.touch]; remove it"
        for key, value in force.items()
        if value is not None
    ]
    return told
