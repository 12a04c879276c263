"""What the tables of an experiment inherit from its robot."""

from typing import Any

from twin.experiment import schema
from twin.experiment.mistakes import keys
from twin.experiment.source import with_numbers


def fill_from_robot(values: dict[str, Any]) -> None:
    """[plant] and [controller.model] are the robot's own values wherever they do not say otherwise."""
    robot = values.get("robot")
    if not isinstance(robot, dict):
        return
    plant, controller = values.setdefault("plant", {}), values.setdefault("controller", {})
    if isinstance(plant, dict):
        values["plant"] = _laid_over(robot, plant, "plant")
    if isinstance(controller, dict):
        model = controller.get("model", {})
        if isinstance(model, dict):
            known = keys(schema.Model)
            believed = {k: v for k, v in robot.items() if k in known}
            controller["model"] = _laid_over(believed, model, "controller.model")


def _laid_over(robot: dict[str, Any], own: dict[str, Any], table: str) -> dict[str, Any]:
    """The robot's values under those of a table, which may name single numbers of three: `joint_zero_deg.2`."""
    numbered = {
        key: with_numbers(value, robot[key], f"{table}.{key}")
        for key, value in own.items()
        if isinstance(value, dict) and isinstance(robot.get(key), tuple)
    }
    return {**robot, **own, **numbered}
