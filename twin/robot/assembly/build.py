"""Constructors of the robot's components from an experiment.

The true parts are the plant at rest, the surface, the encoders, the scale and the drives (one for each joint, or one
FMU for all). Estimator, controller and safety monitor use beliefs: the monitor has its own.
"""

import math
from collections.abc import Callable, Collection, Mapping, Sequence
from dataclasses import dataclass, field, replace
from functools import partial
from pathlib import Path
from typing import TYPE_CHECKING, Protocol

import numpy as np
from numpy.typing import NDArray

from twin.kernel.cosim.component import Component
from twin.kernel.cosim.delay import delay
from twin.kernel.cosim.port import Port
from twin.kernel.errors import InputRefused
from twin.kernel.fmi.description import FmuDescription
from twin.kernel.settings import Triple
from twin.robot.assembly.drives import DrivePlan, Start, drive, plan_drive
from twin.robot.assembly.roles import ThirdPartyPart
from twin.robot.controller import program as programs
from twin.robot.controller.adaptive import AdaptiveOptions
from twin.robot.controller.compliance import FeedForwardModel
from twin.robot.controller.controller import (
    OMEGA_REF,
    P_REF_B,
    Belief,
    Controller,
    Estimator,
    Law,
    WayPointReference,
)
from twin.robot.controller.energy_tank import Tank, TankValve
from twin.robot.controller.pid import Gains, force_gains
from twin.robot.controller.program import Phase
from twin.robot.controller.schedule import SchedulePoint, Scheduling
from twin.robot.controller.task_controller import Computer, TaskController
from twin.robot.controller.tissue import Sensing
from twin.robot.experiment.experiment import Experiment
from twin.robot.experiment.fault import NO_END_TICK, Fault
from twin.robot.experiment.schema import whole_ticks
from twin.robot.mechanism.geometry import geometry_of
from twin.robot.mechanism.kinematics import jacobian, joint_angles
from twin.robot.mechanism.statics import G_ACCELERATION, Masses, leg_inertia, moving_mass
from twin.robot.monitor.component import LINE_PORTS, POWER_PORT, MonitorBelief, SafetyMonitor
from twin.robot.monitor.limits import Limits, Monitor
from twin.robot.plant.component import Plant, rest_state
from twin.robot.plant.contact_law import Contact
from twin.robot.plant.dynamics import PlantParameters, Robot, TrueRobot
from twin.robot.plant.encoder import ENCODER_INPUTS as ANGLES
from twin.robot.plant.encoder import Encoder, Scale, Shaft
from twin.robot.plant.surface_motion import Body, Motion, MotionKind
from twin.robot.shaft import UnpoweredParameters, UnpoweredShaft

if TYPE_CHECKING:
    from twin.robot.remote import RemoteLink

SURFACE_FAULT_RISE = 0.02
"""Rise time (s) of a surface that jumps or drops away as a fault."""
BREATHING_RATE = 0.25
"""Frequency (Hz) of breathing as a fault: 15 per minute."""
JOINTS = 3
LIGHT_TOUCH = 0.3
"""Minimum pressing force (N) for estimating the tissue."""
LATE_PERIODS = 1.5
"""Timeout of an encoder message, in periods of the controller."""
POWER_LINES = ("power", "drive_power")
"""Lines that are on until the first message arrives."""


def plant_parameters(plant: TrueRobot, contact: Contact) -> PlantParameters:
    """Convert the experiment's tables of plant and contact to the true plant parameters in SI."""
    return PlantParameters.from_tables(plant, contact)


def shafts(plant: TrueRobot) -> tuple[Shaft, Shaft]:
    """Return the properties of the motor encoders and of the joint encoders."""
    p = plant
    return (
        Shaft(p.motor_counts_per_turn, p.motor_zero, p.motor_noise, p.motor_eccentricity, p.motor_eccentric_at),
        Shaft(p.joint_counts_per_turn, p.joint_zero, p.joint_noise, p.joint_eccentricity, p.joint_eccentric_at),
    )


def surface_motions(contact: Contact) -> tuple[Motion, ...]:
    """Return the motions that the experiment gives the contact surface; empty for a surface at rest."""
    return tuple(table.motion for table in contact.motions)


def _fault_motion(fault: Fault, tick: float) -> Motion | None:
    onset, end = fault.onset * tick, math.inf if fault.end == NO_END_TICK else fault.end * tick
    up, down = (0.0, 0.0, fault.magnitude), (0.0, 0.0, -fault.magnitude)
    match fault.kind:
        case "surface_jump":
            return Motion(MotionKind.SHIFT, up, onset, end, rise=SURFACE_FAULT_RISE)
        case "contact_loss":
            return Motion(MotionKind.SHIFT, down, onset, end, rise=SURFACE_FAULT_RISE)
        case "breathing":
            return Motion(MotionKind.BREATHING, up, onset, end, rate=BREATHING_RATE)
    return None


class DriveMaker(Protocol):
    """Interface of a factory that creates the components of drives."""

    one_process: bool
    """Whether all its drives run in this process."""

    def drive(self, name: str, plan: DrivePlan, tick: float, theta_m: Start, tau_load: Start) -> Component:
        """Create the component of a drive, in this process or in another one."""


class InProcessDrives:
    """Factory that creates drive components in this process."""

    one_process = True
    drive = staticmethod(drive)


@dataclass(frozen=True)
class Build:
    """The robot to build, at rest in static equilibrium at the start of its experiment.

    Attributes:
        plant: plant at rest.
        theta_m: motor angles in that equilibrium (3,), rad.
        third_party: third-party parts, by role.
    """

    experiment: Experiment
    plans: tuple[DrivePlan, ...]
    maker: DriveMaker
    plant: Plant
    theta_m: NDArray[np.float64]
    third_party: Mapping[str, ThirdPartyPart] = field(default_factory=dict)
    remote: "RemoteLink | None" = None


Makers = Mapping[str, Callable[[], Component]]
"""Constructors of a row's components, by component name; empty for an absent row."""
Parts = Callable[[Build], Makers]


def planned_drives(experiment: Experiment) -> tuple[DrivePlan, ...]:
    """Check the joints' drives without loading any binary and return their plans; equal drives are read once."""
    plans: list[DrivePlan] = []
    for table in experiment.drives:
        plans.append(next((plan for plan in plans if plan.table == table), None) or plan_drive(table))
    if len({plan.axes for plan in plans}) > 1 or (drives_all_joints(plans[0]) and plans[1:] != plans[:1] * 2):
        label = next(plan.label for plan in plans if drives_all_joints(plan))
        raise InputRefused(f"{label}: drives all three joints, so [drive.joint_1] .. cannot differ; remove them")
    ticks, ramped = experiment.duration_ticks, experiment.cosim.inputs == "linear"
    folders: dict[str, Path] = {}
    return tuple(replace(plan, ticks=ticks, ramped=ramped, folders=folders) for plan in plans)


def drives_all_joints(plan: DrivePlan) -> bool:
    """Whether one instance of the drive moves all three joints."""
    return plan.axes == JOINTS


def joint_drives(build: Build) -> Makers:
    """Return the constructors of the drives: one for all joints, or one per joint."""
    tick, theta_m, tau_load = build.experiment.cosim.tick, build.theta_m, build.plant.initial("tau_load")
    if drives_all_joints(build.plans[0]):
        return {"drive": partial(build.maker.drive, "drive", build.plans[0], tick, theta_m, tau_load)}
    return {
        name: partial(build.maker.drive, name, plan, tick, theta_m[i], tau_load[i])
        for i, plan in enumerate(build.plans)
        for name in [f"drive_{i + 1}"]
    }


def have_power_lines(experiment: Experiment) -> bool:
    """Whether twin's own monitor has one power line per drive, as drives specify their unpowered behaviour."""
    stated = any(drive.unpowered is not None for drive in experiment.drives)
    return stated and experiment.monitor is not None and "monitor" not in experiment.stand_ins


def unpowered_shafts(build: Build) -> Makers:
    """Return the constructors of the three motor shafts whose power the safety monitor may cut.

    Empty unless the drives specify their behaviour without power and twin's own monitor is used.
    """
    if not have_power_lines(build.experiment):
        return {}
    stated = [drive.unpowered for drive in build.experiment.drives]
    if None in stated:
        raise InputRefused("[drive.unpowered]: stated for some joints only; state it in [drive], or of each joint")
    return {
        f"shaft_{i}": partial(UnpoweredShaft, f"shaft_{i}", shaft, float(build.theta_m[i - 1]))
        for i, table in enumerate(stated, start=1)
        if table is not None
        for shaft in [UnpoweredParameters(table.holding, table.brake, int(table.brake_line == "own"), table.J, table.b)]
    }


def need_processes(plans: tuple[DrivePlan, ...]) -> bool:
    """Whether the drives need several processes because an FMU allows only one instance per process.

    Raises:
        InputRefused: two parts of one drive are the same such FMU.
    """
    for plan in plans:
        twice = _repeated_single_instance(plan.parts.values())
        if twice:
            raise InputRefused(
                f"{twice.path}: can be instantiated only once per process, and is used for two parts of one drive; "
                "export it without that limit, or as one FMU"
            )
    instances = plans[:1] if drives_all_joints(plans[0]) else plans
    return _repeated_single_instance([fmu for plan in instances for fmu in plan.parts.values()]) is not None


def _repeated_single_instance(fmus: Collection[FmuDescription]) -> FmuDescription | None:
    """Return an FMU that is used repeatedly but allows one instance per process; None if there is no such FMU."""
    digests = [fmu.sha256 for fmu in fmus]
    return next((fmu for fmu in fmus if fmu.single_instance and digests.count(fmu.sha256) > 1), None)


def resting_plant(experiment: Experiment, moved: bool = False) -> tuple[Plant, np.ndarray]:
    """Build the plant at rest at the first waypoint of its reference; return it with its motor angles (3,), rad.

    `moved`: whether a third-party body moves the surface.
    """
    parameters = plant_parameters(experiment.plant, experiment.contact)
    x, theta_m = rest_state(parameters, experiment.start)
    moving, ramp = bool(motions(experiment)) or moved, experiment.cosim.inputs == "linear"
    return Plant(parameters, x, theta_m, experiment.plant.substeps, moving, ramp), theta_m


def plant(build: Build) -> Makers:
    """Return the constructor of the plant: springs, mechanism and contact."""
    return {"plant": lambda: build.plant}


def body(build: Build) -> Makers:
    """Return the constructor of the moving surface; empty if the surface is at rest."""
    found = motions(build.experiment)
    return {"body": lambda: Body(found)} if found else {}


def encoder(build: Build) -> Makers:
    """Return the constructor of the motor and joint encoders."""
    experiment = build.experiment
    motor, joint = shafts(experiment.plant)
    return {"encoder": lambda: Encoder(motor, joint, experiment.controller_ticks, experiment.seed)}


def latency(build: Build) -> Makers:
    """Return the constructor of the delay between the true angles and the encoders; empty without a delay."""
    ticks = whole_ticks(build.experiment.plant.encoder_latency, build.experiment.cosim.tick)
    initial = np.concatenate([build.theta_m, build.plant.initial("theta_l")])
    return {"latency": lambda: delay("latency", ANGLES, ticks, initial)} if ticks else {}


def scale(build: Build) -> Makers:
    """Return the constructor of the electronic scale's display; empty if the experiment has no scale."""
    table = build.experiment.scale
    if table is None:
        return {}
    return {"scale": lambda: Scale(table.resolution * G_ACCELERATION, build.experiment.scale_ticks)}


def motions(experiment: Experiment) -> tuple[Motion, ...]:
    """Return all motions of the experiment's surface: its own, and those caused by faults."""
    caused = (_fault_motion(fault, experiment.cosim.tick) for fault in experiment.faults)
    return (*surface_motions(experiment.contact), *(motion for motion in caused if motion is not None))


def belief(experiment: Experiment) -> Belief:
    """Return the robot model that the estimator believes: [controller.model] and the springs' dead zone."""
    return Belief.from_tables(experiment.controller, experiment.controller.model)


def monitor_belief(robot: Robot) -> MonitorBelief:
    """Return the robot model that the safety monitor believes: [robot], independent of [controller.model]."""
    return MonitorBelief.from_tables(robot, backlash=robot.backlash)


def monitor_limits(monitor: Monitor, speed_limit: float) -> Limits:
    """Convert [monitor] to the safety monitor's limits; `speed_limit` is the controller's command limit (rad/s)."""
    return Limits.from_tables(monitor, command_limit=monitor.command_limit or speed_limit)


def adaptive_options(experiment: Experiment) -> AdaptiveOptions | None:
    """Return the controller's adaptive options from the experiment; None without [controller.tissue]."""
    c = experiment.controller
    if c.tissue is None:
        return None
    scheduling = None
    if c.force.schedule:
        scheduling = Scheduling.from_tables(c.tissue, c.force)
    points = [SchedulePoint.from_tables(point) for point in c.force.schedule]
    learning = 0.0 if c.touch is None else c.touch.force_learning
    return AdaptiveOptions(tissue_sensing(c, experiment.start), scheduling, points, c.breath, learning)


def tissue_sensing(computer: Computer, p_B: Triple) -> Sensing:
    """Return the parameters of the controller's tissue estimate for the believed robot near `p_B` (m)."""
    tissue, model = computer.tissue, computer.model
    assert tissue is not None
    geometry, masses = geometry_of(model), Masses(model.m_a, model.m_b, model.m_p, 0.0)
    # M_zz depends on the rods to first order in J_z, which changes it by grams within reach; dA_i/dtheta is l_a
    # cos(theta)
    downwards = model.l_a * np.cos(joint_angles(geometry, p_B))
    rods = -model.m_b / 3.0 * float(downwards @ jacobian(geometry, p_B)[:, 2])
    # rounding to whole counts has a uniform error
    counts = model.motor_counts_per_turn, model.joint_counts_per_turn
    motor, joint = (2.0 * math.pi / each / math.sqrt(12.0) for each in counts)
    per_motor = model.k_s * model.eta * model.N
    return Sensing.from_tables(
        tissue,
        contact=LIGHT_TOUCH,
        mass=float(moving_mass(masses)) + rods,
        inertia=float(leg_inertia(geometry, masses)),
        joint_spring=per_motor * model.N,
        angle_rounding=joint,
        torque_rounding=per_motor * math.hypot(motor, model.N * joint),
    )


def estimator(experiment: Experiment) -> Estimator:
    """Build the component that estimates position and force from encoder counts."""
    return Estimator(belief(experiment), experiment.controller.gravity_compensation, experiment.controller_ticks)


def controller(experiment: Experiment, program: Sequence[Phase] | None = None) -> Controller | TaskController:
    """Build the component of twin's own controller with the experiment's gains, led by waypoints or tasks.

    In position mode the force loop never starts. `program` replaces the phases of an experiment with tasks.
    """
    c = experiment.controller
    force_on = c.mode == "force_position"
    started = {} if force_on else {"trigger_force": math.inf, "trigger_time": math.inf}
    law = Law.from_tables(c, c.model, c.force, **started)
    position, force = Gains.from_tables(c.position), force_gains(c.force)
    ticks, besides, tank = experiment.controller_ticks, adaptive_options(experiment), c.energy_tank is not None
    if experiment.reference is not None and program is None:
        return Controller(law, position, force, experiment.reference.t, experiment.reference.p, ticks, besides, tank)
    if program is None:
        assert experiment.approach is not None and c.touch is not None
        program = programs.program(experiment.approach, c.touch.contact, experiment.tasks)
    assert c.touch is not None and c.feed_forward is not None and c.damping is not None
    return TaskController(
        law,
        position,
        force,
        FeedForwardModel.from_tables(c.model, c.feed_forward),
        c.damping,
        c.touch,
        program,
        experiment.start,
        ticks,
        besides,
        tank,
    )


def estimators(build: Build) -> Makers:
    """Return the constructor of the estimator."""
    return {"estimator": lambda: estimator(build.experiment)}


def controllers(build: Build) -> Makers:
    """Return the constructor of the controller."""
    return {"controller": lambda: controller(build.experiment)}


def references(build: Build) -> Makers:
    """Return the constructor of the pre-defined path, if a third-party controller has an input for it."""
    other = build.third_party.get("controller")
    if other is None or P_REF_B not in other.inputs:
        return {}
    reference, ticks = build.experiment.reference, build.experiment.controller_ticks
    if reference is None:
        raise InputRefused(f"{other.label}: takes p_ref_B, and tasks have no waypoints; it needs a [reference]")
    return {"reference": lambda: WayPointReference(reference.t, reference.p, ticks)}


def tanks(build: Build) -> Makers:
    """Return the constructor of the energy tank behind the controller; empty if none is configured."""
    c, ticks = build.experiment.controller, build.experiment.controller_ticks
    if c.energy_tank is None:
        return {}
    tank = Tank.from_tables(c.energy_tank, c.model, late=LATE_PERIODS * ticks * build.experiment.cosim.tick)
    return {"tank": lambda: TankValve(tank, ticks)}


def delays(build: Build) -> Makers:
    """Return the constructor of the computation delay behind the controller; empty if none is set."""
    ticks = build.experiment.controller.delay_ticks
    return {"delay": lambda: delay("delay", (OMEGA_REF,), ticks, np.zeros(OMEGA_REF.size))} if ticks else {}


def have_effort(plans: Sequence[DrivePlan]) -> bool:
    """Whether all drives report the torques of their motors."""
    return all(any(port.name == "tau_motor" for port in plan.outputs) for plan in plans)


def remotes(build: Build) -> Makers:
    """Return the constructor of the remote controller; empty unless the robot is served to one."""
    link, experiment = build.remote, build.experiment
    if link is None:
        return {}
    # imported here, as only served runs need it
    from twin.robot.remote import RemoteController

    measured = experiment.scale is not None, have_effort(build.plans), experiment.monitor is not None
    return {"remote": lambda: RemoteController(link, experiment.cosim.tick, experiment.controller_ticks, *measured)}


def monitors(build: Build) -> Makers:
    """Return the constructor of the safety monitor; empty if the experiment has none."""
    experiment = build.experiment
    if experiment.monitor is None:
        return {}
    limits = monitor_limits(experiment.monitor, experiment.controller.speed_limit)
    periods = experiment.controller_ticks, experiment.monitor_ticks
    lines, silence = have_power_lines(experiment), build.remote.silence_limit if build.remote else None
    return {"monitor": lambda: SafetyMonitor(monitor_belief(experiment.robot), limits, *periods, lines, silence)}


def buses(build: Build) -> Makers:
    """Return the constructor of the delaying bus from the computer to the drives; empty without a delay.

    Until the first message arrives the drives are commanded to stand still, with power on.
    """
    ticks = build.experiment.controller.bus_delay_ticks
    if not ticks:
        return {}
    ports: tuple[Port, ...] = (OMEGA_REF,) if build.experiment.monitor is None else (OMEGA_REF, POWER_PORT)
    ports += LINE_PORTS if have_power_lines(build.experiment) else ()
    initial = np.concatenate([np.full(port.size, 1.0 if port.name in POWER_LINES else 0.0) for port in ports])
    return {"bus": lambda: delay("bus", ports, ticks, initial)}
