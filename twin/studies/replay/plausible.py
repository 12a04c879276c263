"""Whether angles can be those of the robot, and what would make them so: a sentence with the map to write."""

import numpy as np
from numpy.typing import NDArray

from twin.robot.controller.controller import Belief, angle
from twin.robot.mechanism.kinematics import platform_position

LARGEST = 2.0
"""rad. No joint of a delta robot turns further from the horizontal."""
MOST_WOUND = 1.0
"""rad of a motor, by which a spring is wound at most where a log begins: five times what it is at a force of 18 N."""
LIKELY = 0.4
"""The same of angles that something is to be proposed for: twice that at 18 N."""
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
        # small angles are poses, whatever they were meant to be
        turned = float(np.max(np.abs(theta_l))) > 2.0 * np.pi
        ways = [way for way in WAYS if (turned or "deg" not in way) and _is_pose(belief, WAYS[way] * theta_l)]
        return _sentence(text, "theta_l", ways)
    if not _wound(belief, theta_m, theta_l) <= MOST_WOUND:
        text = (
            f"{where}: the first motor angles ({', '.join(f'{value:.1f}' for value in np.degrees(theta_m))}) deg are "
            f"not those of these joints, {belief.N:g} times ({', '.join(f'{x:.1f}' for x in np.degrees(theta_l))}) deg"
        )
        wound = {way: _wound(belief, factor * theta_m, theta_l) for way, factor in WAYS.items()}
        ways = sorted((way for way in WAYS if wound[way] <= LIKELY), key=wound.__getitem__)
        return _sentence(text, "theta_m", ways)
    return ""


def _sentence(text: str, name: str, ways: list[str]) -> str:
    if not ways:
        return f"{text}; are their signs, units and zeros those of the experiment?"
    if name == "theta_m" and ways[0] == "-":
        return f"{text}; one of the two has the other sign: write -COLUMN for it in the map"
    column = {"[deg]": "COLUMN[deg]", "-": "-COLUMN", "- and [deg]": "-COLUMN[deg]"}[ways[0]]
    what = {"[deg]": "as degrees", "-": "with the other sign", "- and [deg]": "as degrees of the other sign"}[ways[0]]
    return f"{text}; {what} they do: write 'estimator.{name}[0]={column}' and so on in the map"


def _is_pose(belief: Belief, theta_l: NDArray[np.float64]) -> bool:
    return bool(np.max(np.abs(theta_l)) <= LARGEST and np.all(np.isfinite(platform_position(belief, *theta_l))))


def _wound(belief: Belief, theta_m: NDArray[np.float64], theta_l: NDArray[np.float64]) -> float:
    """The largest angle by which a spring is wound, rad of its motor."""
    return float(np.max(np.abs(theta_m - belief.N * theta_l)))
