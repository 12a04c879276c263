"""Consistency of an experiment's tables with one another and with the robot."""

from collections.abc import Collection, Mapping
from typing import Any

from twin.robot.assembly.build import monitor_belief, plant_parameters
from twin.robot.assembly.checks.adaptive_loop import adaptive_errors
from twin.robot.assembly.checks.monitor_limits import contradictions
from twin.robot.assembly.checks.reach import reference_errors
from twin.robot.assembly.checks.tasks import TaskContext, task_errors
from twin.robot.experiment.experiment import Tables
from twin.robot.experiment.fault import FAULT_KINDS
from twin.robot.experiment.schema import WayPoints
from twin.robot.mechanism.geometry import geometry_of


def disagreements(tables: Tables, reference: WayPoints | None, named: Collection[str]) -> list[str]:
    """Return an error message for each conflict between tables of an experiment that are valid by themselves.

    `reference` is None if its waypoints are invalid; `named` are the names of all tables in the file, valid or not.
    """
    checked = tables.by_name
    other = tables.stand_ins
    mistakes = _mode_errors(checked, named) + _surface_motion_conflicts(tables, named)
    models = [checked["plant"]] if "plant" in checked else []
    models += [checked["controller"].model] if "controller" in checked else []
    geometries = tuple(geometry_of(model) for model in models)
    if reference is not None:
        mistakes += reference_errors(reference, geometries, checked.get("plant"))
    if "monitor" in checked and "monitor" not in other and {"robot", "controller"} <= checked.keys():
        computer = checked["controller"]
        mistakes += contradictions(
            checked["monitor"], monitor_belief(checked["robot"]), computer.period, computer.speed_limit
        )
    mistakes += _adaptive_errors(tables, reference)
    if tables.tasks and {"plant", "contact", "approach", "controller", "head"} <= checked.keys():
        monitor = checked.get("monitor")
        situation = TaskContext(
            plant_parameters(checked["plant"], checked["contact"]),
            checked["plant"],
            geometries,
            checked["approach"],
            checked["controller"],
            monitor if monitor is not None and monitor.enabled and "monitor" not in other else None,
        )
        mistakes += task_errors(situation, tables.tasks, tables.duration)
    return mistakes


def _adaptive_errors(tables: Tables, reference: WayPoints | None) -> list[str]:
    """Return error messages for the adaptive options of twin's own controller; empty for a third-party one."""
    checked = tables.by_name
    computer = checked.get("controller")
    if computer is None or computer.force is None:
        return []
    start = reference.p[0] if reference is not None else None
    if tables.tasks and "approach" in checked:
        start = (*next(iter(tables.tasks.values())).point, checked["approach"].height)
    return list(adaptive_errors(computer, checked.get("plant"), start))


def _surface_motion_conflicts(tables: Tables, named: Collection[str]) -> list[str]:
    """Return an error message for each motion of a surface that a third-party [body] already moves."""
    if "body" not in tables.stand_ins:
        return []
    contact = tables.by_name.get("contact")
    moving = [f"contact.{name}" for name in ("breathing", "shift") if getattr(contact, name, None) is not None]
    moving += [f"fault {n}" for n, fault in enumerate(tables.faults, 1) if FAULT_KINDS[fault.kind].mechanism == "body"]
    label = tables.stand_ins["body"].label
    return [f"[{name}]: moves the surface, and so does [body], {label}; remove one" for name in moving]


def _mode_errors(checked: Mapping[str, Any], named: Collection[str]) -> list[str]:
    """Return error messages for tables missing or superfluous for waypoints or tasks, position or force control."""
    has_tasks = "task" in named
    if has_tasks == ("reference" in named):
        return ["expected either [reference] with way points or [[task]] tables" + (", not both" if has_tasks else "")]
    if "controller" not in checked:
        return []
    computer = checked["controller"]
    if computer.force is None:
        # third-party, with its own modes and gains
        return ["missing table [approach], which tasks need"] if has_tasks and "approach" not in named else []
    if not has_tasks:
        missing = computer.mode == "force_position" and computer.force.reference is None
        return ["[controller.force] missing key 'reference_N'"] if missing else []
    mistakes = [] if "approach" in named else ["missing table [approach], which tasks need"]
    for name in ("touch", "feed_forward", "damping"):
        if getattr(computer, name) is None:
            mistakes.append(f"missing table [controller.{name}], which tasks need")
    if computer.mode != "force_position":
        mistakes.append(f'[controller] mode = "{computer.mode}": tasks press; expected "force_position"')
    mistakes += [
        f"[controller.force] {key}: tasks have a force of their own and feel contact by [controller.touch]; remove it"
        for name, key in (("reference", "reference_N"), ("trigger", "trigger_N"), ("trigger_time", "trigger_time_s"))
        if getattr(computer.force, name) is not None
    ]
    return mistakes
