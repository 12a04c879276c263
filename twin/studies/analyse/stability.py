"""How stable an experiment's loops are: at each operating point, and over contact stiffness and gains.

Gain limits against the co-simulation: the linear model's are tried just below and just above, any drive's. Where they
do not hold the limit is looked for in the co-simulation itself. Two sizes of nudges are tried, because what is not
linear in a drive shows in that they differ: friction brakes small swings more than large ones, registers swallow them
or keep them alive.
"""

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from functools import cache
from typing import Any

import numpy as np

from twin.kernel.errors import InputRefused
from twin.kernel.serialise import to_dict
from twin.robot.assembly.roles import refuse_other_parts
from twin.robot.experiment.experiment import Experiment
from twin.studies.analyse.linear.loops import COMMANDS, LOOPS, DriveModel, closed_poles, spectral_radius
from twin.studies.analyse.linear.margins import (
    LARGEST_GAIN,
    DiskMargin,
    Margins,
    Pole,
    disk_margin,
    gain_limit,
    margins,
    poles,
    worst_sensitivity,
)
from twin.studies.analyse.nudge import aftermaths
from twin.studies.analyse.operating_point import Linearised, LinearPoint, OperatingPoint, on_stiffness, operating_points
from twin.studies.command import Say, Steps, silent

HOLDS = 0.15
"""What a predicted gain limit may be off the simulated one, as a share of that."""
CLOSE = 1.05
"""Ratio of gains between which the simulated limit is left."""
STRIDE = 1.5
"""Ratio of one gain to the next while the limit is looked for."""
FARTHEST = 10.0
"""How far from its prediction, as a factor, a limit is looked for."""
SMALL, LARGE, LARGE_PRESSING = 1e-4, 1e-3, 3e-4
"""Nudges (m): about what the encoders resolve of the platform; a push in air; one that no contact is lost by."""

Lasting = tuple[float, ...]
"""Nudges (m) that last."""


@dataclass(frozen=True)
class LimitCheck:
    """The gain limit of a law at an operating point, predicted and tried.

    Attributes:
        predicted: factor on all gains of the law, see `twin.studies.analyse.linear.margins.gain_limit`.
        low, high: factors between which a nudge begins to last in the co-simulation, each None if it was not reached.
        holds: whether the prediction is confirmed within `HOLDS`.
        reason: why not, as far as it was measured; "" if it holds.
    """

    law: str
    point: OperatingPoint
    predicted: float | None
    low: float | None
    high: float | None
    holds: bool
    reason: str = ""

    @property
    def simulated(self) -> float | None:
        """Factor from which a nudge lasts, found by bisection; None if the prediction holds, or it was not found."""
        if self.holds or self.high is None or self.low is None:
            return None
        return float((self.low * self.high) ** 0.5)

    @property
    def shakes(self) -> bool:
        """Whether a nudge lasts with the gains as they are set."""
        return self.high is not None and self.high <= 1.0

    @property
    def between(self) -> tuple[float | None, float | None]:
        """`low` and `high`."""
        return self.low, self.high

    JSON_KEYS = "law p_B=point.p_B F_z=point.F_z predicted holds simulated simulated_between=between reason"


def checked_limit(
    experiment: Experiment, point: OperatingPoint, law: str, predicted: float | None, drives: Sequence[DriveModel]
) -> LimitCheck:
    """The `predicted` limit of `law` at `point`, tried in the co-simulation, which decides."""

    @cache
    def lasting(factor: float) -> Lasting:
        return lasting_nudges(experiment, point, law, factor)

    expected = LARGEST_GAIN if predicted is None else max(predicted, 1.0 / LARGEST_GAIN)
    low, high = bracket(lambda factor: bool(lasting(factor)), expected, ends=predicted is not None)
    holds = (low, high) == borders(expected) or (predicted is None and high is None)
    return LimitCheck(law, point, predicted, low, high, holds, "" if holds else _reason(drives, lasting, high))


def borders(expected: float) -> tuple[float, float]:
    """Between which the simulated limit has to be for `expected` to hold."""
    return expected / (1.0 + HOLDS), expected / (1.0 - HOLDS)


def bracket(lasts: Callable[[float], bool], expected: float, ends: bool = True) -> tuple[float | None, float | None]:
    """(highest factor tried at which no nudge lasts, next one at which one does), None for an end that is too far off.

    These are `borders` if the limit is between them, else at most `CLOSE` apart.

    Args:
        ends: whether `expected` is a limit, not just a value up to which there is none.
    """
    low, high = borders(expected)
    if lasts(low):
        high, least = low, low / FARTHEST
        low /= STRIDE
        while lasts(low):
            high, low = low, low / STRIDE
            if high <= least:
                return None, high
    elif not ends:
        return low, None
    elif lasts(high):
        return low, high
    else:
        low, most = high, high * FARTHEST
        high *= STRIDE
        while not lasts(high):
            low, high = high, high * STRIDE
            if low >= most:
                return low, None
    return narrowed(lasts, low, high)


def narrowed(lasts: Callable[[float], bool], low: float, high: float) -> tuple[float, float]:
    """`low`, at which no nudge lasts, and `high`, at which one does, bisected until they are `CLOSE`."""
    while high > CLOSE * low:
        middle = (low * high) ** 0.5
        low, high = (low, middle) if lasts(middle) else (middle, high)
    return low, high


def lasting_nudges(experiment: Experiment, point: OperatingPoint, law: str, factor: float) -> Lasting:
    """Which nudges, large and small, last at `point` with `factor` times the gains of `law`."""
    sizes = (LARGE_PRESSING if point.in_contact else LARGE, SMALL)
    left = aftermaths(experiment, point, law, factor, sizes)
    return tuple(size for size, one in zip(sizes, left, strict=True) if one.lasts(size))


def _reason(drives: Sequence[DriveModel], lasting: Callable[[float], Lasting], high: float | None) -> str:
    """What tells a drive from a linear one, of what was measured."""
    reasons = []
    if any(drive.turning for drive in drives):
        reasons.append("at rest the drive is nonlinear for small signals; the linear model is of a turning shaft")
    at_limit = lasting(high) if high is not None else ()
    if at_limit and SMALL not in at_limit:
        reasons.append(f"a perturbation of {1e3 * at_limit[0]:g} mm persists there, one of {1e3 * SMALL:g} mm decays")
    elif at_limit == (SMALL,):
        reasons.append(f"a perturbation of {1e3 * SMALL:g} mm persists there, a larger one decays")
    if not reasons:
        reasons.append("perturbations of all sizes agree, so the linear model is wrong")
    return "; ".join(reasons)


POSITION, FORCE = LOOPS[:3], LOOPS[3:]
LAWS = {"position": POSITION, "force": FORCE}
NEUTRAL = 1e-9
"""What rounding may add to the magnitude of a pole."""
STIFFNESSES = np.geomspace(100.0, 50_000.0, 41)
"""N/m: from fat to a table."""
FACTORS = np.geomspace(0.1, 300.0, 61)
MOST_POLES = 6


@dataclass(frozen=True)
class PointStability:
    """One operating point, judged; margins only where it is stable, for elsewhere they mean nothing.

    Attributes:
        stable: whether every pole is inside the unit circle.
        poles: slowest decay first.
        disks: of all loops at once, opened at the "laws", at the "motors", or at "both".
        sensitivity: of all loops at once, largest singular value; None if unstable.
        limits: "position", "force" -> factor on all gains of that law up to which the point is stable, see
            `twin.studies.analyse.linear.margins.gain_limit`.
    """

    linear: LinearPoint
    stable: bool
    poles: list[Pole]
    margins: dict[str, Margins]
    disks: dict[str, DiskMargin]
    sensitivity: float | None
    limits: dict[str, float | None]

    @property
    def least_damped(self) -> Pole:
        """The pole of the smallest damping ratio."""
        return min(self.poles, key=lambda pole: pole.zeta)

    @property
    def slowest(self) -> list[Pole]:
        """The poles of the slowest decay."""
        return self.poles[:MOST_POLES]

    JSON_KEYS = (
        "name=linear.point.name p_B=linear.point.p_B F_z=linear.point.F_z force_loop=linear.point.force_on "
        "stable loops=margins disk_margins=disks sensitivity gain_limits=limits poles=slowest least_damped"
    )


@dataclass(frozen=True)
class StabilityMap:
    """Damping over contact stiffness and gains at one pressing point, its pose and force kept.

    Attributes:
        stiffness: N/m (n,).
        factors: on all gains of the law (m,).
        zeta: smallest damping ratio of a pole (m, n); < 0: unstable; NaN: no operating point.
    """

    law: str
    at: LinearPoint
    stiffness: np.ndarray
    factors: np.ndarray
    zeta: np.ndarray

    JSON_KEYS = "law p_B=at.point.p_B F_z=at.point.F_z stiffness factors zeta"


@dataclass(frozen=True)
class Stability:
    """An experiment's loops, judged.

    Attributes:
        problems: sentences about points that have no linear model.
        maps: empty where nothing is pressed on.
        checks: the gain limits that were tried in the co-simulation.
    """

    experiment: Experiment
    shared: Linearised
    points: list[PointStability]
    problems: list[str]
    maps: list[StabilityMap]
    checks: list[LimitCheck]

    @property
    def stable(self) -> bool:
        """Whether the linear model is at every point, and no nudge lasts with the gains as they are set."""
        return all(point.stable for point in self.points) and not any(check.shakes for check in self.checks)

    def critical(self, law: str) -> PointStability | None:
        """The point at which the gains of `law` can be raised least; None if nothing limits them."""
        limits = [(limit, point) for point in self.points if (limit := point.limits.get(law)) is not None]
        return min(limits, key=lambda pair: pair[0])[1] if limits else None

    def facts(self) -> dict[str, Any]:
        """For JSON, SI."""
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


def stability(experiment: Experiment, tried: bool = False, say: Say = silent) -> Stability:
    """Judge the loops of `experiment`; its drives are run in this process, its faults are left out."""
    _refuse_other_laws(experiment)
    points, problems = operating_points(experiment)
    steps = Steps(say, len(points) + 2 + tried)
    steps.next("identifying the drives")
    shared = Linearised(experiment, points)
    judged = []
    for point in points:
        steps.next(point.name)
        judged.append(judged_point(shared.at(point)))
    if tried:
        steps.next("trying the gain limits")
    checks = limit_checks(shared, judged) if tried else []
    steps.next("maps and pictures")
    return Stability(experiment, shared, judged, problems, _maps(shared, judged), checks)


def force_loop_margins(experiment: Experiment) -> list[Margins]:
    """Compute the margins of the force loop at each operating point in contact; its drives are run in this process."""
    _refuse_other_laws(experiment)
    points = [point for point in operating_points(experiment)[0] if point.in_contact and point.force_on]
    if not points:
        raise InputRefused(f"{experiment.name}: no force loop in contact")
    shared, found = Linearised(experiment, points), []
    for linear in map(shared.at, points):
        if spectral_radius(linear.loops, linear.gains) >= 1.0 - NEUTRAL:
            raise InputRefused(f"{experiment.name}: unstable {linear.point.name}")
        found.append(margins(linear.loops, linear.gains, "force"))
    return found


def _refuse_other_laws(experiment: Experiment) -> None:
    refuse_other_parts(experiment, "twin analyse", ("controller", "estimator"))
    if schedule := experiment.controller.force.schedule:
        one = schedule[0]
        raise InputRefused(
            f"{experiment.name}: its gains come from [controller.force] schedule; twin analyse takes one set. For "
            f"point 1: --set controller.force.schedule=[] --set controller.force.kp_mm_per_N={1e3 * one.kp:g} --set "
            f"controller.force.ki_mm_per_N_s={1e3 * one.ki:g} --set contact.stiffness_N_per_m={one.stiffness:g}"
        )


def limit_checks(shared: Linearised, judged: list[PointStability]) -> list[LimitCheck]:
    """The limits of each law in air and in contact, each tried where it is lowest.

    Where no gain of a law makes the robot stable there is nothing to try.
    """
    checks: list[LimitCheck] = []
    for law, loops in LAWS.items():
        for in_contact in (False, True):
            there = [p for p in judged if p.linear.point.in_contact == in_contact and loops[0] in p.linear.gains]
            at = min(there, key=lambda point: _room(point, law), default=None)
            if at is not None and at.limits[law] != 0.0:
                limit, point = at.limits[law], at.linear.point
                checks.append(checked_limit(shared.experiment, point, law, limit, shared.drives))
    return checks


def _maps(shared: Linearised, judged: list[PointStability]) -> list[StabilityMap]:
    """Of the pressing point with the least room for its gains, of those with a force loop if there are any."""
    pressing = [point for point in judged if point.linear.point.in_contact]
    with_force = [point for point in pressing if "force" in point.linear.gains]
    law = "force" if with_force else "position"
    at = min(with_force or pressing, key=lambda point: _room(point, law), default=None)
    if at is None:
        return []
    return [stability_map(shared, at.linear, law, names) for law, names in LAWS.items() if names[0] in at.linear.gains]


def _room(point: PointStability, law: str) -> float:
    limit = point.limits[law]
    return np.inf if limit is None else limit


def judged_point(linear: LinearPoint) -> PointStability:
    """Poles, and where they are stable margins and limits."""
    loops, gains = linear.loops, linear.gains
    stable = spectral_radius(loops, gains) < 1.0 - NEUTRAL
    found = poles(closed_poles(loops, gains), loops.dt)
    limits = {law: gain_limit(loops, gains, names) for law, names in LAWS.items() if names[0] in gains}
    if not stable:
        return PointStability(linear, False, found, {}, {}, None, limits)
    each = {name: margins(loops, gains, name) for name in gains}
    breaks = {"laws": tuple(gains), "motors": COMMANDS, "both": (*gains, *COMMANDS)}
    disks = {where: disk_margin(loops, gains, names) for where, names in breaks.items()}
    return PointStability(linear, True, found, each, disks, worst_sensitivity(loops, gains), limits)


def stability_map(shared: Linearised, at: LinearPoint, law: str, names: tuple[str, ...]) -> StabilityMap:
    """Damping with the gains of `names` raised and lowered together, over the contact's stiffness."""
    zeta = np.full((len(FACTORS), len(STIFFNESSES)), np.nan)
    for column, K in enumerate(STIFFNESSES):
        try:
            loops = shared.at(on_stiffness(at.point, K)).loops
        except InputRefused:
            continue
        for row, factor in enumerate(FACTORS):
            z = closed_poles(loops, at.gains | dict.fromkeys(names, factor))
            zeta[row, column] = min(pole.zeta for pole in poles(z, loops.dt))
    return StabilityMap(law, at, STIFFNESSES, FACTORS, zeta)
