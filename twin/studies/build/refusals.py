"""Refusals of experiments and parts that cannot be built."""

from collections.abc import Sequence

from twin.kernel.cosim.system import Feeds
from twin.kernel.errors import InputRefused
from twin.robot.assembly.build import motions
from twin.robot.assembly.declared import FAULT_PLACES, TUNABLE_PLACES
from twin.robot.experiment.experiment import Experiment
from twin.robot.experiment.fault import FAULT_KINDS


def refuse_unbuildable(experiment: Experiment, name: str, wanted: Sequence[str]) -> None:
    """Refuse to export third-party components, and parts that another master could not step."""
    if name.startswith("drive"):
        raise InputRefused(f"{name}: a drive is an FMU already; expected another part of {experiment.name}")
    for role in wanted:
        # a third-party body is fine for the plant, whose body values are then inputs
        if role in experiment.stand_ins and name != "plant":
            label = experiment.stand_ins[role].label
            raise InputRefused(
                f"{experiment.name}: its {role} is {label}; it is third-party, and only twin's own can be built"
            )
    if "plant" in wanted and experiment.cosim.inputs == "linear":
        raise InputRefused(
            f'{experiment.name}: [cosim] inputs = "linear": an FMU holds its inputs over a step; '
            "build the plant with --set cosim.inputs=hold"
        )
    if name == "body" and not motions(experiment):
        raise InputRefused(f"{experiment.name}: its body does not move, so it has no component to build")
    for number, fault in enumerate(experiment.faults, start=1):
        if name == f"fault_{number}":
            _refuse_alone(name, fault.kind)


def _refuse_alone(name: str, kind: str) -> None:
    if kind in FAULT_PLACES:
        owner = FAULT_PLACES[kind].component
        raise InputRefused(
            f"{name}: {kind} writes into the memory of {owner}, which no FMU can do to another; it cannot be built"
        )
    if FAULT_KINDS[kind].mechanism == "body":
        raise InputRefused(f"{name}: {kind} is a motion of the body, and is built with it: expected body or plant")


def refuse_changes(experiment: Experiment, wanted: Sequence[str]) -> None:
    for change in experiment.changes:
        if TUNABLE_PLACES[change.key].component in wanted:
            raise InputRefused(
                f"{experiment.name}: has [[change]] tables, which cannot be built; build it with --set change=[], and "
                f"set {change.key} at that time in the other master"
            )


def refuse_inner_faults(experiment: Experiment, name: str, wanted: Sequence[str], sound: Feeds, feeds: Feeds) -> None:
    """Refuse to export a part with a fault between its own components, which `feeds` has and `sound` has not."""
    instead = f"or build the sound {name} with --set fault=[]"
    for target, source in sound.items():
        if feeds[target] != source and {target.component, source.component} <= set(wanted):
            fault = feeds[target].component
            kind = experiment.faults[int(fault.rpartition("_")[2]) - 1].kind
            apart = ", ".join([*wanted, fault])
            raise InputRefused(
                f"{experiment.name}: {fault} ({kind}) stands between {source.component} and {target.component}, within "
                f"{name}; build its components one by one ({apart}), {instead}"
            )
    for number, fault_ in enumerate(experiment.faults, start=1):
        if fault_.kind in FAULT_PLACES and (owner := FAULT_PLACES[fault_.kind].component) in wanted:
            raise InputRefused(
                f"{experiment.name}: fault_{number} ({fault_.kind}) writes into the memory of {owner}, which no FMU "
                f"can do to another; expected faults between parts, {instead}"
            )
