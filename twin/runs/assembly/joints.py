"""The drives of the three joints: one for each, or one FMU that turns all."""

from functools import partial

from twin.errors import InputRefused
from twin.experiment.experiment import Experiment
from twin.runs.assembly.build import Build, Makers
from twin.runs.assembly.drives import DrivePlan, planned

JOINTS = 3


def planned_drives(experiment: Experiment) -> tuple[DrivePlan, ...]:
    """The joints' drives, checked as far as that goes without loading one; equal ones are read once.

    Raises:
        InputRefused: a drive does not fit.
    """
    plans: list[DrivePlan] = []
    for table in experiment.drives:
        plans.append(next((plan for plan in plans if plan.table == table), None) or planned(table))
    if len({plan.axes for plan in plans}) > 1 or (turns_all(plans[0]) and plans[1:] != plans[:1] * 2):
        label = next(plan.label for plan in plans if turns_all(plan))
        raise InputRefused(f"{label}: drives all three joints; [drive.joint_1] .. cannot differ then, remove them")
    return tuple(plans)


def turns_all(plan: DrivePlan) -> bool:
    """Whether one instance of the drive turns all joints."""
    return plan.axes == JOINTS


def joint_drives(build: Build) -> Makers:
    """`drive`, or `drive_1` to `drive_3`."""
    tick, theta_m, tau_load = build.experiment.cosim.tick, build.theta_m, build.plant.initial("tau_load")
    if turns_all(build.plans[0]):
        return {"drive": partial(build.maker.drive, "drive", build.plans[0], tick, theta_m, tau_load)}
    return {
        name: partial(build.maker.drive, name, plan, tick, theta_m[i], tau_load[i])
        for i, plan in enumerate(build.plans)
        for name in [f"drive_{i + 1}"]
    }


def refuse_second_instances(plans: tuple[DrivePlan, ...]) -> None:
    """Some FMUs can live only once in a process; three joints need three processes then.

    Raises:
        InputRefused: one of them drives more than one joint.
    """
    instances = plans[:1] if turns_all(plans[0]) else plans
    fmus = [fmu for plan in instances for fmu in plan.parts.values()]
    for fmu in fmus:
        only_once = fmu.model.coSimulation.canBeInstantiatedOnlyOncePerProcess
        if only_once and sum(other.sha256 == fmu.sha256 for other in fmus) > 1:
            raise InputRefused(
                f"{fmu.path}: can be instantiated only once per process, and drives more than one joint; "
                "use --isolate drive, which gives each joint's drive a process of its own"
            )
