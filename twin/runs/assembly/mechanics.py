"""What is true: the plant at rest, what it presses on, the encoders and the scale."""

import numpy as np

from twin.cosim.delay import delay
from twin.experiment.experiment import Experiment
from twin.experiment.ticks import whole_ticks
from twin.plant.beginning import resting
from twin.plant.body import Body, Motion
from twin.plant.component import Plant
from twin.plant.encoder import INPUTS as ANGLES
from twin.plant.encoder import Encoder
from twin.plant.scale import Scale
from twin.robot.gravity import G_ACCELERATION
from twin.runs.assembly.build import Build, Makers
from twin.runs.assembly.true_parameters import fault_motions, plant_parameters, shafts, surface_motions


def at_rest(experiment: Experiment, moved: bool = False) -> tuple[Plant, np.ndarray]:
    """The plant in static equilibrium at the first way point of its reference, and the motor angles (3,), rad, there.

    Args:
        moved: whether a body of another make moves the surface.

    Raises:
        Unreachable: the robot cannot be there.
    """
    parameters = plant_parameters(experiment.plant, experiment.contact)
    x, theta_m = resting(parameters, experiment.start)
    moving, ramp = bool(motions(experiment)) or moved, experiment.cosim.inputs == "linear"
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
    experiment = build.experiment
    motor, joint = shafts(experiment.plant)
    return {"encoder": lambda: Encoder(motor, joint, experiment.controller_ticks, experiment.seed)}


def latency(build: Build) -> Makers:
    """The way of the angles into the encoders, if it takes time."""
    ticks = whole_ticks(build.experiment.plant.encoder_latency, build.experiment.cosim.tick)
    initial = np.concatenate([build.theta_m, build.plant.initial("theta_l")])
    return {"latency": lambda: delay("latency", ANGLES, ticks, initial)} if ticks else {}


def scale(build: Build) -> Makers:
    """The electronic scale's display."""
    table = build.experiment.scale
    if table is None:
        return {}
    return {"scale": lambda: Scale(table.resolution * G_ACCELERATION, build.experiment.scale_ticks)}


def motions(experiment: Experiment) -> tuple[Motion, ...]:
    """How the surface moves, by itself and because of faults."""
    return surface_motions(experiment.contact) + fault_motions(experiment.faults, experiment.cosim.tick)
