"""The corners at which gains have to hold: operating points, each on every stiffness and with every drive."""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from twin.errors import InputRefused
from twin.experiment.experiment import Experiment
from twin.studies.analyse.linear.drive_model import Matrix
from twin.studies.analyse.linear.margins import LOWEST, Complex, response
from twin.studies.analyse.linear.sampled_law import ESTIMATED, LOOPS
from twin.studies.analyse.linear.sampled_robot import TRUE
from twin.studies.analyse.linear_point import Linearised
from twin.studies.analyse.nudge import undisturbed
from twin.studies.analyse.operating_point import OperatingPoint, on_stiffness, operating_points
from twin.studies.tune.gains import LawGains, with_gains

STIFFNESSES = 3
"""Of a range: both ends and the geometric mean."""
FREQUENCIES = 500
"""From `LOWEST` to half the sampling rate: 2 % apart, closer than the platform's swings are wide."""
UNITY = LawGains(1.0, 1.0, 0.0)
"""With these the analysis is asked for a robot whose laws are then opened."""


@dataclass(frozen=True)
class Corner:
    """The robot at one operating point with both laws taken off, linear and sampled with the controller's period.

    x(k+1) = A x + B u with u the platform speed (3,) that the position law asks for; y = C x: the position as estimated
    (3,), the low-passed estimated pressing force, the true position (3,), and the true pressing force, SI.

    Attributes:
        experiment: whose drives and settings these are.
        drive: what its drive is called.
        point: where.
        A, B, C: (n, n), (n, 3), (8, n).
        period: s.
        omega: rad/s (m,).
        P: response (m, 4, 3) of what is estimated.
    """

    experiment: Experiment
    drive: str
    point: OperatingPoint
    A: Matrix
    B: Matrix
    C: Matrix
    period: float
    omega: Matrix
    P: Complex

    @property
    def name(self) -> str:
        """`force on 300 N/m`, `position in air`."""
        where = f"on {self.point.parameters.K:.4g} N/m" if self.point.in_contact else "in air"
        return f"{self.laws[0]} {where}"

    @property
    def laws(self) -> tuple[str, ...]:
        """Whose steps are looked at here: while the force law acts it moves z, and friction holds x and y."""
        return ("force",) if self.point.force_on else ("position",)

    @property
    def axes(self) -> tuple[int, ...]:
        """Of the position law, whose steps are looked at here."""
        return (2,) if self.point.in_contact else (0, 1, 2)


def corners(
    experiments: Sequence[Experiment], stiffness: tuple[float, float] | None
) -> tuple[list[Corner], list[str], list[Linearised]]:
    """(corners, sentences about points without a linear model, the drives as identified), one experiment per drive.

    Raises:
        InputRefused: no operating point, no linear model of a drive, a surface too soft for the force.
        ComponentFailed: a drive failed while it was measured.
    """
    points, problems = operating_points(experiments[0])
    if stiffness is not None:
        low, high = stiffness
        each = np.geomspace(low, high, STIFFNESSES) if high > low else [low]
        air = [point for point in points if not point.in_contact]
        try:
            points = air + [on_stiffness(point, float(K)) for point in points if point.in_contact for K in each]
        except InputRefused as refusal:
            raise InputRefused(f"--stiffness-N-per-m {low:g}:{high:g}: {refusal}; raise the lower end") from None
    found, drives = [], []
    for experiment in experiments:
        shared = Linearised(with_gains(experiment, UNITY), points)
        drives.append(shared)
        found += [opened(experiment, shared, point) for point in points]
    return found, problems, drives


def opened(experiment: Experiment, shared: Linearised, point: OperatingPoint) -> Corner:
    """The corner of `experiment` at `point`, with what all points of it share."""
    loops = shared.at(point).loops
    outputs = [loops.output_labels.index(name) for name in (*ESTIMATED, *TRUE)]
    rows = loops.C[outputs]
    # the pressing force is -F_ee_B_z
    rows[-1] *= -1.0
    system = loops[outputs[:4], : len(LOOPS[:3])]
    omega = np.geomspace(LOWEST, 0.999 * np.pi / loops.dt, FREQUENCIES)
    P = response(system, omega)
    return Corner(experiment, shared.labels[0], point, loops.A, loops.B[:, :3], rows, loops.dt, omega, P)


def at_stiffness(corner: Corner) -> Experiment:
    """The corner's experiment with its contact, `undisturbed`."""
    p = corner.point.parameters
    return undisturbed(corner.experiment, stiffness=p.K, height=p.z_s)
