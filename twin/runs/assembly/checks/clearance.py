"""Whether the robot bends or meets itself on its way."""

import numpy as np
from numpy.typing import NDArray

from twin.plant.parameters import TrueRobot
from twin.robot.clearance import BARS, Bars, ball_joint_angles, clearances
from twin.robot.geometry import Geometry
from twin.robot.inverse_kinematics import joint_angles
from twin.runs.assembly.beliefs import geometry_of


def obstructed(plant: TrueRobot, p_B: NDArray[np.float64]) -> tuple[int, str] | None:
    """(which pose, why) the robot cannot be at one of `p_B` (n, 3) in m, all of which it reaches; None if it can.

    What the robot's file does not state does not limit it.
    """
    geometry, places = geometry_of(plant), np.asarray(p_B)
    if (met := _at_a_stop(plant, geometry, places)) is not None:
        return met
    if plant.ball_joint_limit is not None:
        angles = ball_joint_angles(geometry, places)
        if angles.max() > plant.ball_joint_limit:
            pose, leg = divmod(int(np.argmax(angles > plant.ball_joint_limit)), 3)
            return pose, (
                f"at {_told(places[pose])} the ball joints of leg {leg + 1} bend by "
                f"{np.degrees(angles[pose, leg]):.1f} deg, their sockets let them by [plant] "
                f"ball_joint_limit_deg = {np.degrees(plant.ball_joint_limit):g}; move the point towards the axis"
            )
    sizes = plant.link_diameter, plant.rod_diameter, plant.rod_spacing
    if None not in sizes:
        gaps, pairs = clearances(geometry, Bars(*sizes), places)  # type: ignore[arg-type]
        if gaps.min() < 0.0:
            pose = int(np.argmax(gaps < 0.0))
            one, other = (f"{'a rod' if bar % BARS else 'the link'} of leg {bar // BARS + 1}" for bar in pairs[pose])
            return pose, (
                f"at {_told(places[pose])} {one} and {other} are {-1e3 * gaps[pose]:.1f} mm inside each other with "
                "[plant] link_diameter_mm, rod_diameter_mm and rod_spacing_mm; expected them apart, move the point"
            )
    return None


def _at_a_stop(plant: TrueRobot, geometry: Geometry, places: NDArray[np.float64]) -> tuple[int, str] | None:
    """As `obstructed`, of the joints' hard stops."""
    if plant.joint_lower is None and plant.joint_upper is None:
        return None
    theta_l = joint_angles(geometry, places)
    for stop, key, way in ((plant.joint_lower, "joint_lower_deg", -1.0), (plant.joint_upper, "joint_upper_deg", 1.0)):
        if stop is not None and (beyond := way * (theta_l - stop)).max() > 0.0:
            pose, leg = divmod(int(np.argmax(beyond > 0.0)), 3)
            return pose, (
                f"at {_told(places[pose])} joint {leg + 1} is at {np.degrees(theta_l[pose, leg]):.1f} deg, beyond its "
                f"hard stop [plant] {key} = {np.degrees(stop):g}; move the point"
            )
    return None


def _told(p_B: NDArray[np.float64]) -> str:
    return "({}) mm".format(", ".join(f"{1e3 * value:.1f}" for value in p_B))
