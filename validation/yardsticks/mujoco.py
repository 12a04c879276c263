"""The robot in MuJoCo: real bodies, two rods to a parallelogram, ball joints; its constraints solved exactly."""

from collections.abc import Callable, Mapping
from functools import cache, partial

import numpy as np

from twin.plant.parameters import PlantParameters
from twin.runs.assembly.load import load_experiment
from twin.runs.assembly.true_parameters import plant_parameters
from twin.runs.trace import run_in_memory
from validation.masters.robot import ROOT
from validation.yardstick import Yardstick

STATES = 1000
SIDEWAYS = 0.097
"""By how much rods taken as two point masses each make the robot too heavy in x and y at home."""
ALIKE = 1e-9
WHY_ALIKE = (
    "both solve the same equations, ours with 3 coordinates and the engine's with 27 and 18 constraints: what remains is "
    "rounding, some 1e-13 away from singularities and ten times that beside them; a rod that is a millionth heavier "
    "already comes to 1e-7"
)


@cache
def parameters() -> PlantParameters:
    """Of the robot of Fig. 4."""
    experiment = load_experiment(ROOT / "experiments" / "fig4_force_position.toml")
    return plant_parameters(experiment.plant, experiment.contact)


@cache
def found() -> Mapping[str, float]:
    """What differs most in all states, of what both robots are asked."""
    from validation.engine.mechanism import Mechanism
    from validation.engine.robots import EnginesRobot, TwinsRobot, differences, states

    own = parameters()
    return differences(TwinsRobot(own), EnginesRobot(Mechanism(own), own), states(own, STATES))


def those(*keys: str) -> Mapping[str, float]:
    return {key: found()[key] for key in keys}


def too_heavy() -> Mapping[str, float]:
    """By how much the engine's robot at home is heavier with rods that have their mass at their ends."""
    from validation.engine.bodies import DUMBBELL, UNIFORM
    from validation.engine.mechanism import Mechanism

    masses = []
    for rod in (UNIFORM, DUMBBELL):
        mechanism = Mechanism(parameters(), rod)
        mechanism.move(np.array([0.0, 0.0, -0.105]))
        masses.append(mechanism.equations(np.zeros(3)).mass(3))
    return {axis: float(abs(masses[1][i, i] / masses[0][i, i] - 1.0 - SIDEWAYS)) for i, axis in enumerate("xy")}


@cache
def apart() -> Mapping[str, float]:
    """Largest difference of what the plant puts out in the run of Fig. 4, by signal."""
    from validation.engine.plant import run

    experiment = load_experiment(ROOT / "experiments" / "fig4_force_position.toml")
    own, theirs = run_in_memory(experiment), run(experiment)
    return {
        key: float(np.max(np.abs(own[key] - theirs[key])))
        for key in ("plant.F_ee_B", "plant.p_B", "controller.F_z", "estimator.p_B")
    }
