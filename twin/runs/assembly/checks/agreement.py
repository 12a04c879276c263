"""What no table can see alone: whether the tables of an experiment agree with one another and with the robot."""

from collections.abc import Collection

from twin.experiment.modes import mode_mistakes
from twin.experiment.reference import WayPoints
from twin.experiment.tables import Tables
from twin.runs.assembly.beliefs import geometry_of, monitor_belief
from twin.runs.assembly.checks.monitor import contradictions
from twin.runs.assembly.checks.reach import reference_mistakes
from twin.runs.assembly.checks.tasks import Situation, task_mistakes
from twin.runs.assembly.true_parameters import plant_parameters


def disagreements(tables: Tables, reference: WayPoints | None, named: Collection[str]) -> list[str]:
    """Every way in which the tables that are right by themselves do not fit together, one sentence each.

    Args:
        tables: of the experiment. reference: its way points, if they are right.
        named: what the file has, right or not.
    """
    checked = tables.by_name
    mistakes = mode_mistakes(checked, named)
    models = [checked["plant"]] if "plant" in checked else []
    models += [checked["controller"].model] if "controller" in checked else []
    geometries = tuple(geometry_of(model) for model in models)
    if reference is not None:
        mistakes += reference_mistakes(reference, geometries)
    if "monitor" in checked and {"robot", "controller"} <= checked.keys():
        computer = checked["controller"]
        mistakes += contradictions(
            checked["monitor"], monitor_belief(checked["robot"]), computer.period, computer.speed_limit
        )
    if tables.tasks and {"plant", "contact", "approach", "controller", "head"} <= checked.keys():
        monitor = checked.get("monitor")
        situation = Situation(
            plant_parameters(checked["plant"], checked["contact"]),
            geometries,
            checked["approach"],
            checked["controller"],
            monitor if monitor is not None and monitor.enabled else None,
        )
        mistakes += task_mistakes(situation, tables.tasks, tables.duration)
    return mistakes
