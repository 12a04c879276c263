"""Way points or tasks, position or force: what each way of leading the robot needs of the other tables."""

from collections.abc import Collection, Mapping
from typing import Any


def mode_mistakes(checked: Mapping[str, Any], named: Collection[str]) -> list[str]:
    """What is missing or too much, one sentence each.

    Args:
        checked: tables by name, those that are right. named: what the file has, right or not.
    """
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
    for name in ("touch", "feed_forward", "damping"):
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
