"""Workspace, singularities and condition number of another delta beside a public library.

All that it is asked is where its platform is at joint angles, and which angles lead to a place: it has no Jacobian.
"""

import logging
from collections.abc import Callable, Mapping
from functools import cache, partial
from math import inf
from typing import Any, Protocol

import numpy as np
from numpy.typing import NDArray

from twin.robot.mechanism.geometry import Geometry
from twin.robot.mechanism.kinematics import distal_volume, jacobian, joint_angles, transmission_sines
from twin.robot.mechanism.workspace import is_reachable
from validation.yardstick import Yardstick

Numbers = NDArray[np.float64]

LENGTHS = Geometry(a=0.16, b=0.06, l_a=0.30, l_b=0.50)
"""Of the library's own example."""
MIDDLE = np.array([0.0, 0.0, -0.45])
POINTS, RAYS, SEED = 1000, 100, 16
STRIDE = 0.005
"""With which a ray is followed until it leaves the workspace (m)."""
THERE = 1e-7
"""How near a place is to the one that was asked for, for it to be that one (m); the other assembly is elsewhere."""
TURN = 1e-3
"""Of a joint, in differences (rad)."""
INSIDE = 1e-6
"""How far inside of the edge a pose is looked at (m): at the edge itself there may be no angles."""
WELL = 10.0
"""Condition up to which it is compared."""
POSES, ANGLES, CONDITION, EDGE, SINGULAR = "reach", "angles", "condition number", "edge", "singularity"
BOUNDS = {POSES: 0.0, ANGLES: 1e-12, CONDITION: 1e-8, EDGE: 1e-3, SINGULAR: 0.02}


class Library(Protocol):
    """Kinematics of a delta with `LENGTHS`, in base frame B of the twin."""

    def place(self, theta: Numbers) -> Numbers:
        """Of the platform (m), (3,)."""

    def angles(self, p_B: Numbers) -> Numbers:
        """Of the joints (rad), (3,); anything where there are none."""


class VisualKinematics:
    """The library's delta; its first leg points where the twin's x axis would be after a quarter turn."""

    TURNED = np.array([[0.0, -1.0, 0.0], [1.0, 0.0, 0.0], [0.0, 0.0, 1.0]])

    def __init__(self) -> None:
        import matplotlib

        matplotlib.use("Agg")
        from visual_kinematics.Frame import Frame
        from visual_kinematics.RobotDelta import RobotDelta

        self._frame: Any = Frame
        self._robot: Any = RobotDelta(np.array([LENGTHS.a, LENGTHS.b, LENGTHS.l_a, LENGTHS.l_b]))

    def place(self, theta: Numbers) -> Numbers:
        return self.TURNED.T @ self._robot.forward(theta).t_3_1.ravel()

    def angles(self, p_B: Numbers) -> Numbers:
        return self._robot.inverse(self._frame.from_r_3_3(np.eye(3), (self.TURNED @ p_B).reshape(3, 1)))


def reaches(library: Library, p_B: Numbers) -> bool:
    """Whether the library's platform is at `p_B` where the library says that its joints have to be for that."""
    with np.errstate(all="ignore"):
        return bool(np.max(np.abs(library.place(library.angles(p_B)) - p_B)) < THERE)


def edge(inside: Callable[[Numbers], bool], direction: Numbers) -> float:
    """How far it is from the middle of the workspace to where it ends (m)."""
    near = 0.0
    while inside(MIDDLE + (near + STRIDE) * direction):
        near += STRIDE
    far = near + STRIDE
    while far - near > 1e-9:
        middle = 0.5 * (near + far)
        near, far = (middle, far) if inside(MIDDLE + middle * direction) else (near, middle)
    return near


def condition(library: Library, theta: Numbers) -> float:
    """Of d p / d theta, by differences of fourth order."""
    columns = []
    for turn in TURN * np.eye(3):
        near, far = (library.place(theta + k * turn) - library.place(theta - k * turn) for k in (1, 2))
        columns.append((8.0 * near - far) / (12.0 * TURN))
    return float(np.linalg.cond(np.array(columns).T))


def to_singularity(p_B: Numbers) -> float:
    """The smallest of the twin's measures of a singularity, 0 to 1; infinity where the twin cannot reach."""
    if not is_reachable(LENGTHS, p_B):
        return inf
    J = jacobian(LENGTHS, p_B)
    return float(np.minimum(np.min(transmission_sines(LENGTHS, J)), np.abs(distal_volume(J))))


def compared(library: Library) -> dict[str, float]:
    """All differences, by what they are."""
    random = np.random.default_rng(SEED)
    span = LENGTHS.l_a + LENGTHS.l_b
    points = random.uniform((-span, -span, -span), (span, span, 0.0), (POINTS, 3))
    ours, theirs = is_reachable(LENGTHS, points), np.array([reaches(library, p) for p in points])
    found = {POSES: float(np.sum(theirs != ours)), ANGLES: 0.0, CONDITION: 0.0, EDGE: 0.0, SINGULAR: 0.0}

    def note(key: str, difference: float) -> None:
        # keeps nan, which max() may pass over
        found[key] = float(np.maximum(found[key], difference))

    for p in points[theirs & ours]:
        theta, expected = joint_angles(LENGTHS, p), np.linalg.cond(jacobian(LENGTHS, p))
        note(ANGLES, np.max(np.abs(library.angles(p) - theta)))
        if expected < WELL:
            note(CONDITION, abs(condition(library, theta) / expected - 1.0))
    for direction in random.normal(size=(RAYS, 3)):
        way = direction / np.linalg.norm(direction)
        far = edge(partial(reaches, library), way)
        note(EDGE, 1e3 * abs(far - edge(lambda p: bool(is_reachable(LENGTHS, p)), way)))
        note(SINGULAR, to_singularity(MIDDLE + (far - INSIDE) * way))
    return found


@cache
def found() -> Mapping[str, float]:
    # it says so of each pose that it does not reach
    logging.disable(logging.ERROR)
    try:
        return compared(VisualKinematics())
    finally:
        logging.disable(logging.NOTSET)


def that(key: str) -> Mapping[str, float]:
    return {key: found()[key]}


YARDSTICKS = tuple(
    Yardstick(
        f"another delta, {1e3 * LENGTHS.l_a:g} and {1e3 * LENGTHS.l_b:g} mm: {claim}",
        "visual_kinematics, Yue Qi",
        unit,
        BOUNDS[key],
        reason,
        partial(that, key),
        ("visual-kinematics",),
    )
    for key, claim, unit, reason in (
        (POSES, f"which of {POINTS} places it can reach", "places", "it reaches a place or does not"),
        (ANGLES, "joint angles at those that it can reach", "rad", "rounding, more of it beside singularities"),
        (
            CONDITION,
            f"condition number of the Jacobian, below {WELL:g}, beside differences of the library's positions",
            "of the value",
            "differences of fourth order over 1 mrad, whose error grows towards singularities",
        ),
        (
            EDGE,
            f"how far it is to the edge of the workspace in {RAYS} directions",
            "mm",
            "beyond a parallel singularity the library is at the mirrored place, which is another one from 1e-4 mm on",
        ),
        (
            SINGULAR,
            f"a leg stretched or folded, or all rods in one plane, at {RAYS} places of the library's edge",
            "of 1",
            "the measure of a singularity is zero at the edge and goes with the root of the distance, which is 1e-6 m: "
            "the root of 2e-6 m by 0.3 m is 0.0026, more where the edge is met at a slant",
        ),
    )
)
