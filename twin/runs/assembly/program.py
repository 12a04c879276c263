"""[approach] and [[task]] as the phases that the controller goes through."""

from twin.controller import program as programs
from twin.controller.phase import Phase
from twin.experiment.task import Approach, Press, Push, Roll, Tap, Task


def program_of(approach: Approach, contact_force: float, tasks: tuple[Task, ...]) -> list[Phase]:
    """The phases of `tasks`; `contact_force` (N) counts as touching."""
    manner = programs.Approach(contact_force=contact_force, **dict(approach))
    return programs.program(manner, [_in_program(task) for task in tasks])


def _in_program(task: Task) -> programs.Task:
    fields = {name: value for name, value in task if name != "kind"}
    match task:
        case Press():
            return programs.Press(**fields)
        case Tap():
            return programs.Tap(**fields)
        case Roll():
            return programs.Roll(**fields)
        case Push():
            return programs.Push(**fields)
