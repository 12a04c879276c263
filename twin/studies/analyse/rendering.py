"""Stiffness that the force loop renders passively along z, over virtual stiffness and damping."""

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np

from twin.robot.controller.pid import Gains
from twin.studies.analyse.linear.hand import (
    EMPTY_HAND,
    ROUNDING_TOLERANCE,
    FreePlant,
    Hand,
    hand_of,
    hertz,
    linear_plant,
    power_share,
    robot_with,
)
from twin.studies.analyse.linear.loops import LOOPS, Matrix, linear_law
from twin.studies.analyse.linearised import Linearisation
from twin.studies.analyse.operating_point import OperatingPoint

WIDTH_FREQUENCIES = 70
VIRTUAL_STIFFNESS = np.geomspace(50.0, 8000.0, 28)
"""Virtual stiffness (N/m)."""
VIRTUAL_DAMPING = np.geomspace(10.0, 3000.0, 22)
"""Virtual damping (N s/m)."""
WIDTH_HALVINGS = 18
"""Number of bisections of the interval of the largest passive stiffness."""


@dataclass(frozen=True)
class ZWidth:
    """Range of impedances that the force loop can render along z without an integral (Z-width, Colgate and Brown 1994).

    The law commands a speed of kp (p_ref - kp_F (F_ref - F_z) - p), i.e. a spring of 1/kp_F parallel to a damper of
    1/(kp kp_F).

    Attributes:
        stiffness, damping: virtual, N/m (n,) and N s/m (m,).
        least: smallest `power_share` (m, n); NaN if unstable in the air.
        largest: largest stiffness at rest that the robot renders passively (N/m), with its virtual stiffness and
            damping; 0 without such a stiffness.
        spring: stiffness of the physical springs at the point, with the other axes held (N/m).
    """

    point: OperatingPoint
    stiffness: Matrix
    damping: Matrix
    least: Matrix
    largest: tuple[float, float, float]
    spring: float

    JSON_KEYS = (
        "p_B=point.p_B largest_passive_stiffness=largest.0 its_virtual_stiffness=largest.1 "
        "its_virtual_damping=largest.2 spring_stiffness=spring virtual_stiffness=stiffness "
        "virtual_damping=damping least_power_share=least"
    )


def z_width(shared: Linearisation, point: OperatingPoint) -> ZWidth:
    """Compute the range of impedances (Z-width) that the force loop can render along z at an operating point."""
    free = FreePlant(linear_plant(point.parameters, point.x, point.theta_m))
    robot = robot_with(free, EMPTY_HAND, shared.drives, shared.stepping)
    settings, estimation = shared.settings(True), shared.estimation(point)
    omega = 2.0 * np.pi * hertz(shared.stepping.period * shared.stepping.tick, WIDTH_FREQUENCIES)

    def rendering(stiffness: float, damping: float) -> Hand:
        position = Gains(stiffness / damping, 0.0, 0.0, settings.position.derivative_corner)
        force = Gains(1.0 / stiffness, 0.0, 0.0, settings.force.derivative_corner)
        law = linear_law(settings._replace(position=position, force=force), estimation)
        return hand_of(robot, law, dict.fromkeys(LOOPS, 1.0))

    def least(stiffness: float, damping: float) -> float:
        hand = rendering(stiffness, damping)
        return float(power_share(hand.admittance(omega)[:, 2:, 2:]).min()) if hand.stable else np.nan

    chart = np.array([[least(stiffness, damping) for stiffness in VIRTUAL_STIFFNESS] for damping in VIRTUAL_DAMPING])
    largest = (0.0, 0.0, 0.0)
    for row, damping in zip(chart, VIRTUAL_DAMPING, strict=True):
        edge = largest_passive(lambda stiffness, damping=damping: least(stiffness, damping), row)  # type: ignore[misc]
        if edge:
            largest = max(largest, (rendering(edge, damping).stiffness[2], edge, float(damping)))
    return ZWidth(point, VIRTUAL_STIFFNESS, VIRTUAL_DAMPING, chart, largest, float(free.stiffness[2, 2]))


def largest_passive(least: Callable[[float], float], row: Matrix) -> float:
    """Return the largest passive stiffness (N/m), 0 if even the softest is not; `row`: least at VIRTUAL_STIFFNESS."""
    feeding = np.flatnonzero(~(row >= -ROUNDING_TOLERANCE))
    if len(feeding) == 0:
        return float(VIRTUAL_STIFFNESS[-1])
    if feeding[0] == 0:
        return 0.0
    low, high = VIRTUAL_STIFFNESS[feeding[0] - 1], VIRTUAL_STIFFNESS[feeding[0]]
    for _ in range(WIDTH_HALVINGS):
        middle = np.sqrt(low * high)
        low, high = (middle, high) if least(middle) >= -ROUNDING_TOLERANCE else (low, middle)
    return float(low)
