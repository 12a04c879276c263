"""Parameters of fmus/paper_law for an experiment of twin's own controller, and the experiment with it."""

from twin.robot.controller.program import Press, Push, Roll, Tap, Task
from twin.robot.experiment.experiment import Experiment

NEVER = 1e300
KINDS = {Press: 1, Tap: 2, Roll: 3, Push: 4}


def parameters(experiment: Experiment) -> dict[str, float]:
    """What makes the FMU do what twin's own controller does in `experiment`."""
    c = experiment.controller
    on = c.mode == "force_position"
    told = {
        "N": c.model.N, "omega_max": c.speed_limit, "F_ref": c.force.reference or 0.0,
        "trigger_force": c.force.trigger if on and c.force.trigger is not None else NEVER,
        "trigger_time": c.force.trigger_time if on and c.force.trigger_time is not None else NEVER,
        "dp_z_max": c.force.limit, "corner": c.force.filter, "k_s": c.model.k_s, "eta": c.model.eta,
    }  # fmt: skip
    for name, loop in (("position", c.position), ("force", c.force)):
        told |= {f"{name}_{gain}": getattr(loop, gain) for gain in ("kp", "ki", "kd")}
        told[f"{name}_corner"] = loop.derivative_filter
    if experiment.tasks:
        assert c.touch and c.feed_forward and c.damping and experiment.approach
        told |= {
            "mu": c.feed_forward.friction, "lag": c.feed_forward.lag, "damping_gain": c.damping.gain,
            "damping_corner": c.damping.corner, "contact_force": c.touch.contact, "patience": c.touch.patience,
            "turn": c.touch.turn, "learning": c.touch.learning, "tasks": len(experiment.tasks),
            **dict(experiment.approach), **{f"way_{i}": 0.0 for i in (1, 2, 3)},
        }  # fmt: skip
        for number, task in enumerate(experiment.tasks, start=1):
            told |= {f"task_{name}_{number}": value for name, value in _task(task).items()}
    return {name: float(value) for name, value in told.items()}


def _task(task: Task) -> dict[str, float]:
    told: dict[str, float] = {"kind": KINDS[type(task)]}
    for name, value in task.model_dump(exclude={"kind"}).items():
        if name == "point":
            told |= {"x": value[0], "y": value[1]}
        elif name == "to":
            told |= {"to_x": value[0], "to_y": value[1]}
        else:
            told[name] = value
    return told
