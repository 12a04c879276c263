"""Angles and places of another delta as they are printed: ABB's FlexPicker with the dimensions Williams gives."""

import math
from collections.abc import Mapping

import numpy as np

from twin.robot.mechanism.geometry import Geometry
from twin.robot.mechanism.kinematics import joint_angles, position
from validation.yardstick import Yardstick

BASE_SIDE, PLATFORM_SIDE = 0.567, 0.076
"""Sides of the two triangles (m): joints are in the middle of the base's sides and at the platform's corners."""
FLEXPICKER = Geometry(a=BASE_SIDE / math.sqrt(12.0), b=PLATFORM_SIDE / math.sqrt(3.0), l_a=0.524, l_b=1.244)
PRINTED = (
    "printed in the README of Pieces98/Deltarobot_Kinematics on GitHub, after R. L. Williams II, The Delta Parallel "
    "Robot: Kinematics Solutions, Ohio University, 2016"
)
PLACES = {
    (0.0, 0.0, 0.0): (0.0, 0.0, -1064.4517),
    (10.0, 20.0, 30.0): (108.1354, -180.3484, -1243.5413),
    (-20.5, -20.5, -20.5): (0.0, 0.0, -900.3195),
    (47.5, -11.6, 21.4): (300.4598, 499.9385, -1099.8281),
    (0.0, 0.0, 60.0): (619.5159, -357.6777, -1040.1298),
}
"""Platform (mm) at joint angles (degrees)."""
ANGLES = {
    (0.0, 0.0, -1064.45): (0.0, 0.0, 0.0),
    (108.14, -180.35, -1243.54): (10.0, 20.0, 30.0),
    (0.0, 0.0, -900.32): (-20.5, -20.5, -20.5),
    (300.46, 499.94, -1099.83): (47.5, -11.6, 21.4),
    (0.0, 0.0, -1762.22): (90.0, 90.0, 90.0),
    (500.0, 0.0, -1000.0): (6.36, -23.26, 33.49),
}
"""Joint angles (degrees) at places of the platform (mm)."""


def places(geometry: Geometry = FLEXPICKER) -> Mapping[str, float]:
    """Distances (mm)."""
    return {
        f"{angles}": float(np.max(np.abs(1e3 * position(geometry, np.radians(angles)) - place)))
        for angles, place in PLACES.items()
    }


def angles(geometry: Geometry = FLEXPICKER) -> Mapping[str, float]:
    """Differences (degrees)."""
    return {
        f"{place}": float(np.max(np.abs(np.degrees(joint_angles(geometry, np.array(place) / 1e3)) - angles)))
        for place, angles in ANGLES.items()
    }


YARDSTICKS = (
    Yardstick(
        f"another delta, 524 and 1244 mm: where the platform is at {len(PLACES)} printed triples of joint angles",
        PRINTED,
        "mm",
        5.01e-5,
        "half of the last digit that is printed",
        places,
    ),
    Yardstick(
        f"another delta, 524 and 1244 mm: joint angles at {len(ANGLES)} printed places",
        PRINTED,
        "degrees",
        5.01e-3,
        "half of the last digit that is printed",
        angles,
    ),
)
