"""Whether angles can be those of the robot, and what would make them so: a sentence with the map to write."""

import numpy as np
from numpy.typing import NDArray

from twin.robot.controller.controller import Belief, angle
from twin.robot.mechanism.kinematics import platform_position

LARGEST = 2.0
"""rad. No joint of a delta robot turns further from the horizontal."""
MOST_WOUND = 3.0
"""rad of a motor, by which a spring is wound at most: several times what the force limits allow."""
WAYS = {"[deg]": np.pi / 180.0, "-": -1.0, "- and [deg]": -np.pi / 180.0}
"""What may have been left out of a map, and what angles then have to be multiplied by."""


def refusal(where: str, count_m: NDArray[np.float64], count_l: NDArray[np.float64], belief: Belief) -> str:
    """Why counts (3,) of motors and joints cannot be of the robot; "" if they can.

    Args:
        where: begins the sentence.
        belief: turns counts into angles.
    """
    theta_m = np.array([angle(count_m[i], belief.motor_counts, belief.motor_zero[i]) for i in range(3)])
    theta_l = np.array([angle(count_l[i], belief.joint_counts, belief.joint_zero[i]) for i in range(3)])
    if not _is_pose(belief, theta_l):
        text = (
            f"{where}: the first joint angles ({', '.join(f'{value:.1f}' for value in np.degrees(theta_l))}) deg fit "
            "no pose of the robot"
        )
        return _sentence(text, "theta_l", [way for way, factor in WAYS.items() if _is_pose(belief, factor * theta_l)])
    if not _is_wound(belief, theta_m, theta_l):
        text = (
            f"{where}: the first motor angles ({', '.join(f'{value:.1f}' for value in np.degrees(theta_m))}) deg are "
            f"not those of these joints, {belief.N:g} times ({', '.join(f'{x:.1f}' for x in np.degrees(theta_l))}) deg"
        )
        ways = [way for way, factor in WAYS.items() if _is_wound(belief, factor * theta_m, theta_l)]
        return _sentence(text, "theta_m", ways)
    return ""


def _sentence(text: str, name: str, ways: list[str]) -> str:
    if not ways:
        return f"{text}; are their signs, units and zeros those of the experiment?"
    column = {"[deg]": "COLUMN[deg]", "-": "-COLUMN", "- and [deg]": "-COLUMN[deg]"}[ways[0]]
    what = {"[deg]": "as degrees", "-": "with the other sign", "- and [deg]": "as degrees of the other sign"}[ways[0]]
    return f"{text}; {what} they do: write 'estimator.{name}[0]={column}' and so on in the map"


def _is_pose(belief: Belief, theta_l: NDArray[np.float64]) -> bool:
    return bool(np.max(np.abs(theta_l)) <= LARGEST and np.all(np.isfinite(platform_position(belief, *theta_l))))


def _is_wound(belief: Belief, theta_m: NDArray[np.float64], theta_l: NDArray[np.float64]) -> bool:
    return bool(np.max(np.abs(theta_m - belief.N * theta_l)) <= MOST_WOUND)
