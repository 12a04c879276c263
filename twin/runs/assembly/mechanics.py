"""What is true: the plant at rest, what it presses on, the encoders and the scale."""

import numpy as np

from twin.experiment.experiment import Experiment
from twin.experiment.fault import NEVER, Fault
from twin.plant.body import Body, Motion, MotionKind
from twin.plant.component import Plant
from twin.plant.encoder import Encoder
from twin.plant.equilibrium import resting
from twin.plant.scale import Scale
from twin.robot.gravity import G_ACCELERATION
from twin.runs.assembly.build import Build, Makers
from twin.runs.assembly.true_parameters import plant_parameters, surface_motions

SUDDEN = 0.02
"""Time (s) in which a surface jumps or drops away as a fault."""
BREATHING_RATE = 0.25
"""Of breathing as a fault (Hz): 15 per minute."""


def at_rest(experiment: Experiment) -> tuple[Plant, np.ndarray]:
    """The plant in static equilibrium at the first way point of its reference, and the motor angles (3,), rad, there.

    Raises:
        Unreachable: the robot cannot be there.
    """
    parameters = plant_parameters(experiment.plant, experiment.contact)
    x, theta_m = resting(parameters, experiment.start)
    moving, ramp = bool(motions(experiment)), experiment.cosim.inputs == "linear"
    return Plant(parameters, x, theta_m, experiment.plant.substeps, moving, ramp), theta_m


def plant(build: Build) -> Makers:
    """Springs, mechanism and contact."""
    return {"plant": lambda: build.plant}


def body(build: Build) -> Makers:
    """A surface that moves."""
    found = motions(build.experiment)
    return {"body": lambda: Body(found)} if found else {}


def encoder(build: Build) -> Makers:
    """Motor and joint encoders."""
    p, experiment = build.experiment.plant, build.experiment
    return {
        "encoder": lambda: Encoder(
            p.motor_counts_per_turn, p.joint_counts_per_turn, p.motor_zero, p.joint_zero, experiment.controller_ticks,
            p.motor_noise, p.joint_noise, experiment.seed,
        )
    }  # fmt: skip


def scale(build: Build) -> Makers:
    """The electronic scale's display."""
    table = build.experiment.scale
    if table is None:
        return {}
    return {"scale": lambda: Scale(table.resolution * G_ACCELERATION, build.experiment.scale_ticks)}


def motions(experiment: Experiment) -> list[Motion]:
    """How the surface moves, by itself and because of faults."""
    faulty = (motion for fault in experiment.faults for motion in _motion(fault, experiment.cosim.tick))
    return [*surface_motions(experiment.contact), *faulty]


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
