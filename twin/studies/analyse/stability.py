"""Stability of an experiment's loops at each operating point, and over contact stiffness and gains."""

from dataclasses import dataclass
from typing import Any

import numpy as np

from twin.kernel.errors import InputRefused
from twin.kernel.serialise import to_dict
from twin.robot.assembly.roles import refuse_third_party_parts
from twin.robot.experiment.experiment import Experiment
from twin.studies.analyse.limit_check import LimitCheck, check_limit
from twin.studies.analyse.linear.loops import LOOPS, SPEED_COMMANDS, closed_poles, spectral_radius
from twin.studies.analyse.linear.margins import (
    DiskMargin,
    Margins,
    Pole,
    disk_margin,
    gain_limit,
    margins,
    poles,
    worst_sensitivity,
)
from twin.studies.analyse.linearised import Linearisation, LinearPoint
from twin.studies.analyse.operating_point import operating_points, point_on_stiffness
from twin.studies.command import Say, Steps, ignore_progress

POSITION_LOOPS, FORCE_LOOPS = LOOPS[:3], LOOPS[3:]
LAW_LOOPS = {"position": POSITION_LOOPS, "force": FORCE_LOOPS}
ROUNDING_TOLERANCE = 1e-9
MAP_STIFFNESSES = np.geomspace(100.0, 50_000.0, 41)
"""Contact stiffnesses of a stability map (N/m), from fat to a table."""
MAP_FACTORS = np.geomspace(0.1, 300.0, 61)
MAX_POLES = 6


@dataclass(frozen=True)
class PointStability:
    """Stability of the loops at one operating point; margins only where it is stable, else they have no meaning.

    Attributes:
        poles: slowest decay first.
        disks: disk margins of all loops at once, opened at the "laws", at the "motors", or at "both".
        sensitivity: largest singular value of the sensitivity of all loops at once; None if unstable.
        limits: `gain_limit` of each law, "position" and "force".
    """

    linear: LinearPoint
    stable: bool
    poles: list[Pole]
    margins: dict[str, Margins]
    disks: dict[str, DiskMargin]
    sensitivity: float | None
    limits: dict[str, float | None]

    @property
    def least_damped_pole(self) -> Pole:
        return min(self.poles, key=lambda pole: pole.zeta)

    @property
    def slowest_poles(self) -> list[Pole]:
        return self.poles[:MAX_POLES]

    JSON_KEYS = (
        "name=linear.point.name p_B=linear.point.p_B F_z=linear.point.F_z force_loop=linear.point.force_on "
        "stable loops=margins disk_margins=disks sensitivity "
        "gain_limits=limits poles=slowest_poles least_damped=least_damped_pole"
    )


@dataclass(frozen=True)
class StabilityMap:
    """Smallest damping ratio of the loops over contact stiffness and gains, at constant pose and force.

    Attributes:
        stiffness, factors: contact stiffness (N/m) (n,), and factor on all gains of the law (m,).
        zeta: smallest damping ratio of a pole (m, n); < 0 if unstable, NaN without an operating point.
    """

    law: str
    at: LinearPoint
    stiffness: np.ndarray
    factors: np.ndarray
    zeta: np.ndarray

    JSON_KEYS = "law p_B=at.point.p_B F_z=at.point.F_z stiffness factors zeta"


@dataclass(frozen=True)
class Stability:
    """Result of the linear analysis: points, messages on points without a model, maps (empty if nothing is pressed)."""

    experiment: Experiment
    shared: Linearisation
    points: list[PointStability]
    problems: list[str]
    maps: list[StabilityMap]
    checks: list[LimitCheck]

    @property
    def stable(self) -> bool:
        """Whether the linear model is stable at every point and no nudge lasts in the co-simulation."""
        return all(point.stable for point in self.points) and not any(check.shakes for check in self.checks)

    def critical(self, law: str) -> PointStability | None:
        """Return the operating point with the lowest gain limit of a law; None if the gains are unlimited."""
        limits = [(limit, point) for point in self.points if (limit := point.limits.get(law)) is not None]
        return min(limits, key=lambda pair: pair[0])[1] if limits else None

    def to_dict(self) -> dict[str, Any]:
        c = self.experiment.controller
        return {
            "experiment": self.experiment.name,
            "stable": self.stable,
            "period": self.shared.stepping.period * self.shared.stepping.tick,
            "gains": {"position": {"kp": c.position.kp}, "force": {"kp": c.force.kp, "ki": c.force.ki}},
            "drives": [
                {"drive": label, "states": len(model.A), "residual": model.residual, "turning": model.turning}
                for label, model in zip(self.shared.labels, self.shared.drives, strict=True)
            ],
            "points": to_dict(self.points),
            "gain_limits": to_dict(self.checks),
            "without_linear_model": self.problems,
            "maps": to_dict(self.maps),
        }


def stability(experiment: Experiment, tried: bool = False, say: Say = ignore_progress) -> Stability:
    """Analyse the stability of an experiment's loops, without its faults; the drives run in this process."""
    _refuse_other_laws(experiment)
    points, problems = operating_points(experiment)
    steps = Steps(say, len(points) + 2 + tried)
    steps.next("identifying the drives")
    shared = Linearisation(experiment, points)
    judged = []
    for point in points:
        steps.next(point.name)
        judged.append(judge_point(shared.linear_point(point)))
    if tried:
        steps.next("trying the gain limits")
    checks = limit_checks(shared, judged) if tried else []
    steps.next("maps and pictures")
    return Stability(experiment, shared, judged, problems, _maps(shared, judged), checks)


def force_loop_margins(experiment: Experiment) -> list[Margins]:
    _refuse_other_laws(experiment)
    points = [point for point in operating_points(experiment)[0] if point.in_contact and point.force_on]
    if not points:
        raise InputRefused(f"{experiment.name}: no force loop in contact")
    shared, found = Linearisation(experiment, points), []
    for linear in map(shared.linear_point, points):
        if spectral_radius(linear.loops, linear.gains) >= 1.0 - ROUNDING_TOLERANCE:
            raise InputRefused(f"{experiment.name}: unstable {linear.point.name}")
        found.append(margins(linear.loops, linear.gains, "force"))
    return found


def _refuse_other_laws(experiment: Experiment) -> None:
    refuse_third_party_parts(experiment, "twin analyse", ("controller", "estimator"))
    if schedule := experiment.controller.force.schedule:
        one = schedule[0]
        raise InputRefused(
            f"{experiment.name}: its gains come from [controller.force] schedule; twin analyse takes one set. For "
            f"point 1: --set controller.force.schedule=[] --set controller.force.kp_mm_per_N={1e3 * one.kp:g} --set "
            f"controller.force.ki_mm_per_N_s={1e3 * one.ki:g} --set contact.stiffness_N_per_m={one.stiffness:g}"
        )


def limit_checks(shared: Linearisation, judged: list[PointStability]) -> list[LimitCheck]:
    """Check the lowest gain limits of each law, in air and in contact; skip laws without a stabilising gain."""
    checks: list[LimitCheck] = []
    for law, loops in LAW_LOOPS.items():
        for in_contact in (False, True):
            there = [p for p in judged if p.linear.point.in_contact == in_contact and loops[0] in p.linear.gains]
            at = min(there, key=lambda point: _room(point, law), default=None)
            if at is not None and at.limits[law] != 0.0:
                limit, point = at.limits[law], at.linear.point
                checks.append(check_limit(shared.experiment, point, law, limit, shared.drives))
    return checks


def _maps(shared: Linearisation, judged: list[PointStability]) -> list[StabilityMap]:
    """Compute stability maps of the pressing point with the lowest gain limit."""
    pressing = [point for point in judged if point.linear.point.in_contact]
    with_force = [point for point in pressing if "force" in point.linear.gains]
    law = "force" if with_force else "position"
    at = min(with_force or pressing, key=lambda point: _room(point, law), default=None)
    if at is None:
        return []
    return [
        stability_map(shared, at.linear, law, names) for law, names in LAW_LOOPS.items() if names[0] in at.linear.gains
    ]


def _room(point: PointStability, law: str) -> float:
    limit = point.limits[law]
    return np.inf if limit is None else limit


def judge_point(linear: LinearPoint) -> PointStability:
    """Compute poles and gain limits of the loops at an operating point, and their margins if it is stable."""
    loops, gains = linear.loops, linear.gains
    stable = spectral_radius(loops, gains) < 1.0 - ROUNDING_TOLERANCE
    found = poles(closed_poles(loops, gains), loops.dt)
    limits = {law: gain_limit(loops, gains, names) for law, names in LAW_LOOPS.items() if names[0] in gains}
    if not stable:
        return PointStability(linear, False, found, {}, {}, None, limits)
    each = {name: margins(loops, gains, name) for name in gains}
    breaks = {"laws": tuple(gains), "motors": SPEED_COMMANDS, "both": (*gains, *SPEED_COMMANDS)}
    disks = {where: disk_margin(loops, gains, names) for where, names in breaks.items()}
    return PointStability(linear, True, found, each, disks, worst_sensitivity(loops, gains), limits)


def stability_map(shared: Linearisation, at: LinearPoint, law: str, names: tuple[str, ...]) -> StabilityMap:
    """Compute the smallest damping ratio over contact stiffness and a common factor on some loops' gains."""
    zeta = np.full((len(MAP_FACTORS), len(MAP_STIFFNESSES)), np.nan)
    for column, K in enumerate(MAP_STIFFNESSES):
        try:
            loops = shared.linear_point(point_on_stiffness(at.point, K)).loops
        except InputRefused:
            continue
        for row, factor in enumerate(MAP_FACTORS):
            z = closed_poles(loops, at.gains | dict.fromkeys(names, factor))
            zeta[row, column] = min(pole.zeta for pole in poles(z, loops.dt))
    return StabilityMap(law, at, MAP_STIFFNESSES, MAP_FACTORS, zeta)
