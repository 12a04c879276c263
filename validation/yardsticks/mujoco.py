"""The robot in MuJoCo: real bodies, two rods to a parallelogram, ball joints; constraints are solved here, exactly."""

from collections.abc import Mapping
from functools import cache, partial

import numpy as np

from twin.robot.assembly.build import plant_parameters
from twin.robot.assembly.load import load_experiment
from twin.robot.experiment.experiment import Experiment
from twin.robot.plant.dynamics import PlantParameters
from twin.robot.run.trace import Trace, run_in_memory
from validation.masters.robot import ROOT
from validation.yardstick import Yardstick

STATES = 1000
HOME = np.array([0.0, 0.0, -0.105])
HEAVIER = 0.097
"""By how much rods taken as two point masses each make the robot at home too heavy in x and y (docs/physics.md)."""
ALIKE = 1e-9
WHY_ALIKE = (
    "ours are 3 equations, the engine's 27 with 18 constraints: if they say the same, rounding is left; it "
    "grows where a leg is nearly stretched or the parallelograms hardly hold the platform; distal rods that are a "
    "millionth heavier are already out"
)
SAME_RUN = 1e-9
WHY_SAME_RUN = (
    "the same springs, contact, steps, drives and controller around another robot: what remains of the rounding in its "
    "accelerations, which no encoder sees"
)
ENGINE = "MuJoCo, Google DeepMind"


def experiment() -> Experiment:
    """Fig. 4."""
    return load_experiment(ROOT / "experiments" / "fig4_force_position.toml")


def parameters() -> PlantParameters:
    """Of its robot."""
    return plant_parameters(experiment().plant, experiment().contact)


@cache
def answers() -> Mapping[str, float]:
    """What differs most in all states, of all that both robots are asked."""
    from validation.engine.mechanism import Mechanism
    from validation.engine.robots import EnginesRobot, TwinsRobot, differences, states

    own = parameters()
    return differences(TwinsRobot(own), EnginesRobot(Mechanism(own), own), states(own, STATES))


def those(*keys: str) -> Mapping[str, float]:
    return {key: answers()[key] for key in keys}


def heavier() -> Mapping[str, float]:
    """How far from `HEAVIER` the engine's robot is, once its rods have their mass at their ends."""
    from validation.engine.bodies import DUMBBELL, UNIFORM
    from validation.engine.mechanism import Mechanism

    def mass(rod: float) -> np.ndarray:
        mechanism = Mechanism(parameters(), rod)
        mechanism.move(HOME)
        return mechanism.equations(np.zeros(3)).mass(3)

    more = mass(DUMBBELL) / mass(UNIFORM) - 1.0
    return {"x": abs(float(more[0, 0]) - HEAVIER), "y": abs(float(more[1, 1]) - HEAVIER)}


@cache
def engines_run() -> Trace:
    from validation.engine.plant import run

    return run(experiment())


def apart(theirs: Trace, own: Trace, keys: Mapping[str, float]) -> dict[str, float]:
    """Largest difference of two runs by signal, times what `keys` has for it."""
    return {key: gain * float(np.max(np.abs(theirs[key] - own[key]))) for key, gain in keys.items()}


def beside_engine(**keys: float) -> Mapping[str, float]:
    return apart(engines_run(), run_in_memory(experiment()), keys)


def of_states(what: str, *keys: str) -> Yardstick:
    return Yardstick(
        f"{STATES} poses and speeds over the workspace: {what}",
        ENGINE,
        "of the value",
        ALIKE,
        WHY_ALIKE,
        partial(those, *keys),
        ("mujoco",),
    )


def of_run(what: str, unit: str, **keys: float) -> Yardstick:
    return Yardstick(
        f"20 s of Fig. 4 with the engine's robot for a plant: {what}",
        ENGINE,
        unit,
        SAME_RUN,
        WHY_SAME_RUN,
        partial(beside_engine, **keys),
        ("mujoco",),
    )


YARDSTICKS = (
    of_states(
        "joint angles, Jacobian and mass matrix, for two uniform rods per parallelogram",
        "joint angles",
        "Jacobian",
        "mass matrix",
    ),
    of_states("gravity", "gravity"),
    of_states("accelerations with springs, joint friction and weight", "acceleration"),
    of_states(
        "at rest, the force of each pair of rods on the platform beside (25), weightless and with weight, and (27)",
        "rods, weightless",
        "rods",
        "force on what it presses",
    ),
    Yardstick(
        "rods taken as two point masses each make the engine's robot, too, 9.7 % heavier sideways at home",
        ENGINE,
        "of the mass",
        5e-4,
        "a percentage given to a tenth",
        heavier,
        ("mujoco",),
    ),
    of_run("force", "N", **{"plant.F_ee_B": 1.0, "controller.F_z": 1.0}),
    of_run("position", "mm", **{"plant.p_B": 1e3, "estimator.p_B": 1e3}),
)
