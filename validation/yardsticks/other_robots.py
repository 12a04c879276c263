"""Robots of other sizes and shapes in MuJoCo: poses, Jacobian, mass matrix and gravity of any robot file."""

from collections.abc import Mapping
from functools import cache
from pathlib import Path
from tempfile import TemporaryDirectory

import numpy as np

from twin.robot.assembly.build import plant_parameters
from twin.robot.experiment.source import read_source
from twin.robot.mechanism.geometry import Geometry
from twin.robot.mechanism.kinematics import position
from twin.robot.plant.contact_law import Contact
from twin.robot.plant.dynamics import PlantParameters, TrueRobot
from validation.masters.robot import ROOT
from validation.yardstick import Yardstick
from validation.yardsticks.mujoco import ALIKE, ENGINE

STATES = 200
"""Number of poses and speeds per robot."""
OTHER_ROBOTS: Mapping[str, Mapping[str, float]] = {
    "0.6 of the size": {"a_mm": 30.0, "b_mm": 18.0, "l_a_mm": 36.0, "l_b_mm": 68.3},
    "1.4 of the size": {
        "a_mm": 70.0, "b_mm": 42.0, "l_a_mm": 84.0, "l_b_mm": 159.5, "m_a_g": 80.0, "m_b_g": 60.0, "m_p_g": 200.0,
    },
    "long rods": {
        "a_mm": 80.0, "b_mm": 35.0, "l_a_mm": 100.0, "l_b_mm": 180.0, "m_a_g": 90.0, "m_b_g": 25.0, "m_p_g": 150.0,
    },
    "wide base": {"a_mm": 120.0, "b_mm": 30.0, "l_a_mm": 70.0, "l_b_mm": 150.0, "m_b_g": 50.0},
    "platform wider than the base": {"a_mm": 40.0, "b_mm": 60.0, "l_a_mm": 60.0, "l_b_mm": 130.0, "m_p_g": 300.0},
}  # fmt: skip
"""Values of [robot] in robot files by name; all others are those of the shipped robot. The arms of the wide base cannot
be horizontal."""
WHY_ALIKE = (
    "ours are 3 equations, the engine's 27 with 18 constraints: if they say the same, rounding is left, whatever the "
    "lengths and masses"
)


def file_parameters(robot_file: Path) -> PlantParameters:
    """Return the plant parameters of a robot file, on the scale of Fig. 4."""
    values = read_source(robot_file).values
    robot = TrueRobot.model_validate({**values["robot"], **values.get("plant", {})})
    scale = read_source(ROOT / "experiments" / "bodies" / "scale.toml").values["contact"]
    return plant_parameters(robot, Contact.model_validate(scale))


def robot_file_text(values: Mapping[str, float]) -> str:
    """Return a robot file with the given values of [robot]; all others are those of the shipped robot."""
    lines = "\n".join(f"{key} = {value!r}" for key, value in values.items())
    return f'extends = "robots/massage_robot.toml"\n[robot]\n{lines}\n'


def differences_from_engine(parameters: PlantParameters, number: int) -> dict[str, float]:
    """Return the largest relative differences between twin's robot and the engine's, over states of its workspace.

    Args:
        parameters: parameters of any robot.
        number: number of states.
    """
    from validation.engine.mechanism import Mechanism
    from validation.engine.robots import EnginesRobot, TwinsRobot, differences, states

    mechanism, given = Mechanism(parameters), states(parameters, number)
    found = differences(TwinsRobot(parameters), EnginesRobot(mechanism, parameters), given)
    geometry, apart = Geometry(parameters.a, parameters.b, parameters.l_a, parameters.l_b), 0.0
    for state in given:
        mechanism.restart()
        mechanism.move(state.p_B)
        off = np.linalg.norm(position(geometry, mechanism.theta_l) - mechanism.p_B) / np.linalg.norm(mechanism.p_B)
        apart = float(np.maximum(apart, off))
    return {"forward kinematics": apart, **found}


@cache
def other_robots() -> Mapping[str, float]:
    """Return the differences of all `OTHER_ROBOTS`, by "robot: quantity"."""
    found: dict[str, float] = {}
    with TemporaryDirectory() as folder:
        for name, values in OTHER_ROBOTS.items():
            file = Path(folder) / "robot.toml"
            file.write_text(robot_file_text(values), encoding="utf-8")
            differences = differences_from_engine(file_parameters(file), STATES)
            found |= {f"{name}: {quantity}": off for quantity, off in differences.items()}
    return found


YARDSTICKS = (
    Yardstick(
        f"{len(OTHER_ROBOTS)} robot files of other sizes and shapes, {STATES} poses and speeds each: forward "
        "kinematics, joint angles, Jacobian, mass matrix, gravity, accelerations, forces in rods",
        ENGINE,
        "of the value",
        ALIKE,
        WHY_ALIKE,
        other_robots,
        ("mujoco",),
    ),
)
