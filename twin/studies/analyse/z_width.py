"""The stiffness that the force loop renders along z, over virtual stiffness and damping; how much of it passively."""

from collections.abc import Callable
from dataclasses import dataclass
from typing import Any

import numpy as np

from twin.controller.pid import Gains
from twin.studies.analyse.linear.drive_model import Matrix
from twin.studies.analyse.linear.hand import NEUTRAL, NOTHING, FreePlant, Hand, hand_of, hertz, power_share, robot_with
from twin.studies.analyse.linear.plant_system import linear_plant
from twin.studies.analyse.linear.sampled_law import LOOPS, linear_law
from twin.studies.analyse.linear_point import Linearised
from twin.studies.analyse.operating_point import OperatingPoint

WIDTH_FREQUENCIES = 70
"""So many are looked at of a cell of the map."""
RENDERED = np.geomspace(50.0, 8000.0, 28)
"""Virtual stiffness (N/m)."""
DAMPED = np.geomspace(10.0, 3000.0, 22)
"""Virtual damping (N s/m)."""
WIDTH_HALVINGS = 18
"""Of the interval in which the largest stiffness is looked for."""


@dataclass(frozen=True)
class Width:
    """What the force loop can render along z without an integral (Z-width, Colgate and Brown 1994).

    The law asks for kp (p_ref - kp_F (F_ref - F_z) - p) of speed, which is a spring of 1/kp_F with a damper of
    1/(kp kp_F) beside it.

    Attributes:
        point: where.
        stiffness, damping: virtual, N/m (n,) and N s/m (m,).
        least: smallest `power_share` (m, n); NaN: unstable in the air.
        largest: stiffness at rest that the robot renders passively (N/m), and the virtual stiffness and damping with
            which it does; 0: none.
        spring: the physical springs' there, with the other axes held (N/m).
    """

    point: OperatingPoint
    stiffness: Matrix
    damping: Matrix
    least: Matrix
    largest: tuple[float, float, float]
    spring: float

    def facts(self) -> dict[str, Any]:
        """For JSON, SI."""
        rendered, stiffness, damping = self.largest
        return {
            "p_B": list(self.point.p_B),
            "largest_passive_stiffness": rendered,
            "its_virtual_stiffness": stiffness,
            "its_virtual_damping": damping,
            "spring_stiffness": self.spring,
            "virtual_stiffness": self.stiffness.tolist(),
            "virtual_damping": self.damping.tolist(),
            "least_power_share": [[None if np.isnan(v) else v for v in row] for row in self.least.tolist()],
        }


def z_width(shared: Linearised, point: OperatingPoint) -> Width:
    """What can be rendered along z at `point`, where the force loop presses."""
    free = FreePlant(linear_plant(point.parameters, point.x, point.theta_m))
    robot = robot_with(free, NOTHING, shared.drives, shared.stepping)
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

    chart = np.array([[least(stiffness, damping) for stiffness in RENDERED] for damping in DAMPED])
    largest = (0.0, 0.0, 0.0)
    for row, damping in zip(chart, DAMPED, strict=True):
        edge = largest_passive(lambda stiffness, damping=damping: least(stiffness, damping), row)  # type: ignore[misc]
        if edge:
            largest = max(largest, (rendering(edge, damping).stiffness[2], edge, float(damping)))
    return Width(point, RENDERED, DAMPED, chart, largest, float(free.stiffness[2, 2]))


def largest_passive(least: Callable[[float], float], row: Matrix) -> float:
    """The virtual stiffness (N/m) up to which `least` is not negative; 0: not even the softest.

    Args:
        row: `least` at `RENDERED`.
    """
    feeding = np.flatnonzero(~(row >= -NEUTRAL))
    if len(feeding) == 0:
        return float(RENDERED[-1])
    if feeding[0] == 0:
        return 0.0
    low, high = RENDERED[feeding[0] - 1], RENDERED[feeding[0]]
    for _ in range(WIDTH_HALVINGS):
        middle = np.sqrt(low * high)
        low, high = (middle, high) if least(middle) >= -NEUTRAL else (low, middle)
    return float(low)
