"""From an experiment to components and wires: the only place where the parts meet."""

import math
from collections.abc import Callable, Mapping
from contextlib import ExitStack
from dataclasses import dataclass

import numpy as np

from twin.assembly.drives import DrivePlan, Start, drive, planned
from twin.controller.belief import Belief
from twin.controller.controller import NEVER, OMEGA_REF, Controller, Law
from twin.controller.estimator import Estimator
from twin.controller.pid import Gains
from twin.cosim.component import Component
from twin.cosim.delay import delay
from twin.cosim.system import System
from twin.errors import InputRefused
from twin.experiment.experiment import Experiment
from twin.plant.component import Plant
from twin.plant.contact_law import LAWS
from twin.plant.encoder import Encoder
from twin.plant.equilibrium import resting
from twin.plant.parameters import PlantParameters
from twin.plant.scale import Scale
from twin.plant.surface import SHAPES
from twin.robot.gravity import G_ACCELERATION


@dataclass
class Assembly:
    """A system that owns its FMU instances; a context manager that frees them.

    Attributes:
        system: ready to be simulated. drives: what stands behind the three joints.
    """

    system: System
    drives: tuple[DrivePlan, ...]

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
        InputRefused: a drive FMU does not fit. All three are checked before any is loaded.
    """
    plans = _planned_drives(experiment)
    if drive_maker is drive:
        _refuse_second_instances(plans)
    parameters = plant_parameters(experiment)
    x, theta_m = resting(parameters, experiment.reference.p[0])
    plant = Plant(parameters, x, theta_m, experiment.plant.substeps, bool(experiment.contact.motions))
    tau_load = plant.initial("tau_load")
    period = experiment.controller_ticks
    components: list[Component] = [
        Encoder(
            experiment.plant.motor_counts_per_turn,
            experiment.plant.joint_counts_per_turn,
            experiment.plant.motor_zero,
            experiment.plant.joint_zero,
            period,
        ),
        Estimator(belief(experiment), experiment.controller.gravity_compensation, period),
        controller(experiment),
        *_delayed(experiment),
        Scale(experiment.scale.resolution * G_ACCELERATION, experiment.scale_ticks),
    ]
    commander = "delay" if experiment.controller.delay_ticks else "controller"
    with ExitStack() as made:
        if plans[0].axes == 3:
            components.append(drive_maker("drive", plans[0], experiment.cosim.tick, theta_m, tau_load))
            made.callback(components[-1].close)
            wires = _wires(commander) + _common_drive_wires(commander)
        else:
            for i, plan in enumerate(plans):
                components.append(drive_maker(f"drive_{i + 1}", plan, experiment.cosim.tick, theta_m[i], tau_load[i]))
                made.callback(components[-1].close)
            wires = _wires(commander) + _joint_drive_wires(commander)
        components = [(substitutes or {}).get(c.name, c) for c in [*components, plant]]
        system = System(components, wires, experiment.cosim.tick, experiment.cosim.scheme)
        made.pop_all()
    return Assembly(system, plans)


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


def plant_parameters(experiment: Experiment) -> PlantParameters:
    """What is true, as the plant's constants."""
    p, c = experiment.plant, experiment.contact
    return PlantParameters(
        a=p.a, b=p.b, l_a=p.l_a, l_b=p.l_b, m_a=p.m_a, m_b=p.m_b, m_p=p.m_p, I_r=p.I_r, b_j=p.b_j,
        k_s=p.k_s, N=p.N, eta=p.eta, backlash=p.backlash, eta_rate=p.eta_rate,
        z_s=c.height, tilt=c.tilt, tilt_x=c.tilt_x,
        shape=SHAPES[c.shape], radius=math.inf if c.radius is None else c.radius,
        law=LAWS[c.law], K=c.stiffness, **{"damping": 0.0, **c.law_constants},
        mu=c.friction, sigma_0=c.bristle, sigma_1=c.bristle_damping,
    )  # fmt: skip


def belief(experiment: Experiment) -> Belief:
    """What the controller believes."""
    m = experiment.controller.model
    return Belief(
        a=m.a, b=m.b, l_a=m.l_a, l_b=m.l_b, m_a=m.m_a, m_b=m.m_b, m_p=m.m_p, k_s=m.k_s, N=m.N, eta=m.eta,
        motor_counts=m.motor_counts_per_turn, joint_counts=m.joint_counts_per_turn,
        motor_zero=m.motor_zero, joint_zero=m.joint_zero,
    )  # fmt: skip


def controller(experiment: Experiment) -> Controller:
    """The force-position law with the experiment's gains and reference; in position mode nothing ever triggers it."""
    c = experiment.controller
    force_on = c.mode == "force_position"
    law = Law(
        N=c.model.N,
        omega_max=c.speed_limit,
        F_z_ref=c.force.reference,
        trigger_force=c.force.trigger if force_on and c.force.trigger is not None else NEVER,
        trigger_time=c.force.trigger_time if force_on and c.force.trigger_time is not None else NEVER,
        dp_z_max=c.force.limit,
        corner=c.force.filter,
    )
    position = Gains(c.position.kp, c.position.ki, c.position.kd, c.position.derivative_filter)
    force = Gains(c.force.kp, c.force.ki, c.force.kd, c.force.derivative_filter)
    return Controller(law, position, force, experiment.reference.t, experiment.reference.p, experiment.controller_ticks)


def _planned_drives(experiment: Experiment) -> tuple[DrivePlan, ...]:
    """The joints' drives; equal ones are read once."""
    plans: list[DrivePlan] = []
    for table in experiment.drives:
        plans.append(next((plan for plan in plans if plan.table == table), None) or planned(table))
    if len({plan.axes for plan in plans}) > 1 or (plans[0].axes == 3 and plans[1:] != plans[:1] * 2):
        label = next(plan.label for plan in plans if plan.axes == 3)
        raise InputRefused(f"{label}: drives all three joints; [drive.joint_1] .. cannot differ then, remove them")
    return tuple(plans)


def _delayed(experiment: Experiment) -> list[Component]:
    """The computation delay between controller and drives, if one is set."""
    ticks = experiment.controller.delay_ticks
    return [delay("delay", OMEGA_REF, ticks, np.zeros(OMEGA_REF.size))] if ticks else []


def _wires(commander: str) -> list[tuple[str, str]]:
    wires = [
        ("plant.theta_l", "encoder.theta_l"),
        ("encoder.count_m", "estimator.count_m"),
        ("encoder.count_l", "estimator.count_l"),
        ("estimator.p_B", "controller.p_B"),
        ("estimator.J", "controller.J"),
        ("estimator.F_ee_B", "controller.F_ee_B"),
        ("plant.F_ee_B", "scale.F_ee_B"),
    ]
    if commander != "controller":
        wires.append(("controller.omega_ref", f"{commander}.omega_ref"))
    return wires


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
