"""From an experiment to components and wires: the only place where the parts meet."""

import difflib
from collections.abc import Callable, Mapping
from contextlib import ExitStack
from dataclasses import dataclass, field
from itertools import pairwise

import numpy as np

from twin.assembly.computer import computation_delay, controller, estimator, safety_monitor
from twin.assembly.drives import ENABLE, DrivePlan, Start, drive, planned
from twin.assembly.faults.inject import inject
from twin.assembly.true_parameters import plant_parameters, surface_motions
from twin.assembly.tunable import scheduled
from twin.cosim.component import Component
from twin.cosim.system import System
from twin.errors import InputRefused
from twin.experiment.experiment import Experiment
from twin.experiment.fault import NEVER, Fault
from twin.plant.body import Body, Motion, MotionKind
from twin.plant.component import Plant
from twin.plant.encoder import Encoder
from twin.plant.equilibrium import resting
from twin.plant.scale import Scale
from twin.robot.gravity import G_ACCELERATION

SUDDEN = 0.02
"""Time (s) in which a surface jumps or drops away as a fault."""
BREATHING_RATE = 0.25
"""Of breathing as a fault (Hz): 15 per minute."""


@dataclass
class Assembly:
    """A system that owns its FMU instances; a context manager that frees them.

    Attributes:
        system: ready to be simulated. drives: what stands behind the three joints.
        substituted: what took the place of the experiment's own components, by their names.
    """

    system: System
    drives: tuple[DrivePlan, ...]
    substituted: dict[str, str] = field(default_factory=dict)

    def __enter__(self) -> "Assembly":
        return self

    def __exit__(self, *failure: object) -> None:
        self.close()

    def close(self) -> None:
        for component in self.system.components:
            component.close()


DriveMaker = Callable[[str, DrivePlan, float, Start, Start], Component]


def assemble(
    experiment: Experiment, substitutes: Mapping[str, Component] | None = None, drive_maker: DriveMaker = drive
) -> Assembly:
    """Build every component of `experiment` and wire them.

    The robot starts at rest in static equilibrium at the first way point of its reference.

    Args:
        experiment: what to build.
        substitutes: components of the same ports that take the place of the ones with their names.
        drive_maker: what makes a drive of its plan, with the arguments of `drives.drive`.

    Raises:
        InputRefused: a drive FMU does not fit; all three are checked before any is loaded. Or a substitute for which
            there is no place.
    """
    plans = _planned_drives(experiment)
    if drive_maker is drive:
        _refuse_second_instances(plans)
    parameters = plant_parameters(experiment.plant, experiment.contact)
    x, theta_m = resting(parameters, experiment.start)
    ramp = experiment.cosim.inputs == "linear"
    motions = [*surface_motions(experiment.contact), *_faulty_motions(experiment)]
    plant = Plant(parameters, x, theta_m, experiment.plant.substeps, bool(motions), ramp)
    tau_load = plant.initial("tau_load")
    body: list[Component] = [Body(motions)] if motions else []
    scale: list[Component] = []
    if experiment.scale is not None:
        scale = [Scale(experiment.scale.resolution * G_ACCELERATION, experiment.scale_ticks)]
    delayed, watched = computation_delay(experiment), safety_monitor(experiment)
    if watched:
        plans = tuple(plan.switchable() for plan in plans)
    components: list[Component] = [
        *body,
        _encoder(experiment),
        estimator(experiment),
        controller(experiment),
        *delayed,
        *watched,
        *scale,
    ]
    chain = ["controller", *(c.name for c in (*delayed, *watched))]
    with ExitStack() as made:
        if plans[0].axes == 3:
            components.append(drive_maker("drive", plans[0], experiment.cosim.tick, theta_m, tau_load))
            made.callback(components[-1].close)
            wires = _common_drive_wires(chain[-1])
        else:
            for i, plan in enumerate(plans):
                components.append(drive_maker(f"drive_{i + 1}", plan, experiment.cosim.tick, theta_m[i], tau_load[i]))
                made.callback(components[-1].close)
            wires = _joint_drive_wires(chain[-1])
        if watched:
            wires += _power_wires(components)
        components = _with_substitutes([*components, plant], substitutes or {})
        wires += _wires(chain, bool(body), bool(scale), bool(watched))
        if ramp:
            wires += [
                (source, target.replace("plant.theta_m", "plant.theta_m_start"))
                for source, target in wires
                if target.startswith("plant.theta_m")
            ]
        if experiment.tasks:
            wires.append(("estimator.tau_l", "controller.tau_l"))
        components, wires = inject(
            components,
            wires,
            experiment.faults,
            experiment.cosim.tick,
            (experiment.plant.motor_counts_per_turn, experiment.plant.joint_counts_per_turn),
            experiment.controller.speed_limit,
        )
        cosim = experiment.cosim
        system = System(components, wires, cosim.tick, cosim.scheme, cosim.inputs, cosim.iterations)
        system.changes = scheduled(experiment, system)
        made.pop_all()
    return Assembly(system, plans, {name: _kind(component) for name, component in (substitutes or {}).items()})


def _with_substitutes(components: list[Component], substitutes: Mapping[str, Component]) -> list[Component]:
    names = [component.name for component in components]
    for name in substitutes:
        if name not in names:
            close = difflib.get_close_matches(name, names, 1)
            hint = f"did you mean '{close[0]}'?" if close else f"there are {', '.join(names)}"
            raise InputRefused(f"substitutes: no component '{name}' in this experiment; {hint}")
    return [substitutes.get(component.name, component) for component in components]


def _kind(component: Component) -> str:
    """What a substitute is: the class of a user's model, or that of the component."""
    own = type(component).__name__
    return f"{component.label} ({own})" if component.label else own


def _encoder(experiment: Experiment) -> Encoder:
    p = experiment.plant
    return Encoder(
        p.motor_counts_per_turn, p.joint_counts_per_turn, p.motor_zero, p.joint_zero, experiment.controller_ticks,
        p.motor_noise, p.joint_noise, experiment.seed,
    )  # fmt: skip


def _faulty_motions(experiment: Experiment) -> list[Motion]:
    """What the surface does besides its own motions because of a fault."""
    return [motion for fault in experiment.faults for motion in _motion(fault, experiment.cosim.tick)]


def _motion(fault: Fault, tick: float) -> list[Motion]:
    onset, end = fault.onset * tick, np.inf if fault.end == NEVER else fault.end * tick
    up = (0.0, 0.0, fault.magnitude)
    match fault.kind:
        case "surface_jump":
            return [Motion(MotionKind.SHIFT, up, onset, end, rise=SUDDEN)]
        case "contact_loss":
            return [Motion(MotionKind.SHIFT, (0.0, 0.0, -fault.magnitude), onset, end, rise=SUDDEN)]
        case "breathing":
            return [Motion(MotionKind.BREATHING, up, onset, end, rate=BREATHING_RATE)]
    return []


def _refuse_second_instances(plans: tuple[DrivePlan, ...]) -> None:
    """Some FMUs can live only once in a process; three joints need three processes then."""
    instances = plans[:1] if plans[0].axes == 3 else plans
    fmus = [fmu for plan in instances for fmu in plan.parts.values()]
    for fmu in fmus:
        only_once = fmu.model.coSimulation.canBeInstantiatedOnlyOncePerProcess
        if only_once and sum(other.sha256 == fmu.sha256 for other in fmus) > 1:
            raise InputRefused(
                f"{fmu.path}: can be instantiated only once per process, and drives more than one joint; "
                "use --isolate drive, which gives each joint's drive a process of its own"
            )


def _planned_drives(experiment: Experiment) -> tuple[DrivePlan, ...]:
    """The joints' drives; equal ones are read once."""
    plans: list[DrivePlan] = []
    for table in experiment.drives:
        plans.append(next((plan for plan in plans if plan.table == table), None) or planned(table))
    if len({plan.axes for plan in plans}) > 1 or (plans[0].axes == 3 and plans[1:] != plans[:1] * 2):
        label = next(plan.label for plan in plans if plan.axes == 3)
        raise InputRefused(f"{label}: drives all three joints; [drive.joint_1] .. cannot differ then, remove them")
    return tuple(plans)


def _wires(chain: list[str], body: bool, scale: bool, watched: bool) -> list[tuple[str, str]]:
    """All wires but the drives'; `chain` is where the command goes through, from the controller on."""
    wires = [
        ("plant.theta_l", "encoder.theta_l"),
        ("encoder.count_m", "estimator.count_m"),
        ("encoder.count_l", "estimator.count_l"),
        ("estimator.p_B", "controller.p_B"),
        ("estimator.J", "controller.J"),
        ("estimator.F_ee_B", "controller.F_ee_B"),
    ]
    wires += [(f"{source}.omega_ref", f"{target}.omega_ref") for source, target in pairwise(chain)]
    if watched:
        wires += [(f"encoder.{name}", f"monitor.{name}") for name in ("count_m", "count_l", "sample")]
    if scale:
        wires.append(("plant.F_ee_B", "scale.F_ee_B"))
    if body:
        wires += [("body.s_B", "plant.s_B"), ("body.v_s_B", "plant.v_s_B")]
    return wires


def _power_wires(components: list[Component]) -> list[tuple[str, str]]:
    """The monitor's power to every drive that can be switched."""
    return [
        ("monitor.power", f"{component.name}.{port.name}" + (f"[{i}]" if port.size > 1 else ""))
        for component in components
        for port in component.inputs
        if port.name == ENABLE
        for i in range(port.size)
    ]


def _joint_drive_wires(commander: str) -> list[tuple[str, str]]:
    wires = []
    for i in range(3):
        joint = f"drive_{i + 1}"
        wires += [
            (f"{joint}.theta_m", f"encoder.theta_m[{i}]"),
            (f"{joint}.theta_m", f"plant.theta_m[{i}]"),
            (f"{commander}.omega_ref[{i}]", f"{joint}.omega_ref"),
            (f"plant.tau_load[{i}]", f"{joint}.tau_load"),
        ]
    return wires


def _common_drive_wires(commander: str) -> list[tuple[str, str]]:
    """One drive of three axes."""
    return [
        ("drive.theta_m", "encoder.theta_m"),
        ("drive.theta_m", "plant.theta_m"),
        (f"{commander}.omega_ref", "drive.omega_ref"),
        ("plant.tau_load", "drive.tau_load"),
    ]
