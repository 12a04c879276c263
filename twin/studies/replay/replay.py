"""Replay of a robot's log: estimates, plant model, residuals and their drift."""

import math
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from twin.kernel.cosim.delay import values_by_port
from twin.kernel.errors import InputRefused
from twin.kernel.recording.logs.log import Log, LogError
from twin.kernel.units import parse_float
from twin.robot.controller.controller import ESTIMATOR_OUTPUTS
from twin.robot.plant.component import PLANT_OUTPUTS as MOTION
from twin.robot.plant.dynamics import LONGEST_GAP
from twin.studies.replay.drift import Drift, drift
from twin.studies.replay.model import RobotModel
from twin.studies.replay.parts import Estimates, PlantModel, Rows, best_estimate, pressing
from twin.studies.replay.plausible import MapCheck
from twin.studies.replay.residual import Residual, Statistics, angle_rounding, force_rounding, residual, statistics
from twin.studies.replay.samples import RobotSamples, robot_samples

MIN_BASELINE_SAMPLES = 20
"""Minimum number of samples in the baseline, and of measured forces."""

Outputs = dict[str, NDArray[np.float64]]
"""Outputs of a component by port, (n,) or (n, size), SI."""


@dataclass(frozen=True)
class Indicator:
    """Residual tested for a changed mean: `force` (N) or `joint 1` .. `joint 3` (rad), t (n,) in s, r (n,)."""

    name: str
    unit: str
    t: NDArray[np.float64]
    r: NDArray[np.float64]
    drift: Drift

    JSON_KEYS = (
        "name unit matches=drift.matches since_s=drift.since alarm_s=drift.alarm size=drift.size "
        "baseline=drift.baseline sigma=drift.sigma tolerance=drift.tolerance slack=drift.slack "
        "threshold=drift.threshold block_s=drift.block"
    )


@dataclass(frozen=True)
class Replay:
    """Result of a replay of a log, SI.

    Attributes:
        estimator: outputs of the controller's estimator at the samples, by port.
        twin: outputs with the plant's dead zone; identical to `estimator` if the belief has the dead zone.
        plant: outputs of the plant model; None if it was not simulated.
        joints: joint angles of the plant model less those of the log (n, 3), rad; None if it was not simulated.
        starts: times of the plant model's starts (s).
        forces: F_z of `estimator`, `twin` and `plant` against the measured force; empty without one.
        indicators: the force first; empty without a signal independent of the encoders.
    """

    model: RobotModel
    log: RobotSamples
    estimator: Outputs
    twin: Outputs
    plant: Outputs | None
    joints: NDArray[np.float64] | None
    starts: tuple[float, ...]
    forces: dict[str, Residual]
    indicators: tuple[Indicator, ...]

    @property
    def statistics(self) -> dict[str, Statistics]:
        return {name: statistics(one) for name, one in self.forces.items()}

    @property
    def first_alarm(self) -> Indicator | None:
        """Residual with the first alarm of the replay; None without an alarm."""
        drifted = [one for one in self.indicators if not one.drift.matches]
        return min(drifted, key=lambda one: one.drift.alarm, default=None)


def normal_time(text: str) -> tuple[float, float]:
    """Parse the baseline of a log into (from, to), s after the first sample: `2` is 0 to 2, `1:3` is 1 to 3."""
    first, colon, last = text.rpartition(":")
    begin, end = parse_float(first) if colon else 0.0, parse_float(last)
    if begin is None or end is None or not (math.isfinite(end) and 0.0 <= begin < end):
        raise InputRefused(f"--baseline {text}: expected a time > 0 s, or FROM:TO with 0 <= FROM < TO, for example 1:3")
    return begin, end


def replay_log(
    log: Log,
    model: RobotModel,
    plant: bool = False,
    baseline: tuple[float, float] = (0.0, 1.0),
    tolerance: float | None = None,
) -> Replay:
    """Replay a robot's log with a model of the robot: estimate position and force, and test the residuals for changes.

    The force is judged by the estimate with the dead zone. The paper's estimator ignores the dead zone; its error
    changes by twice the dead zone's torque when a spring changes its side, also on a healthy robot.

    Args:
        plant: whether to simulate the plant model, too.
        baseline: (from, to) after the first sample (s), the reference, best in free air; earlier samples are not
            judged.
        tolerance: accepted change of the mean force residual (N); None for the effect of rounding.
    """
    robot = robot_samples(log, model.belief)
    _refuse_lengths(robot, baseline, tolerance)
    if plant and robot.sampling.period > LONGEST_GAP:
        raise LogError(
            f"a sample every {robot.sampling.period:.3g} s; the plant model needs one every {LONGEST_GAP:g} s or sooner"
        )
    rows = estimates(robot, model)
    estimator = values_by_port(ESTIMATOR_OUTPUTS, rows["estimator"])
    best = best_estimate(rows) if "twin" in rows else estimator
    followed = PlantModel(model, restarts=False)
    simulated = followed.feed(robot, rows) if plant else {}
    motion = values_by_port(MOTION, simulated["plant"]) if plant else None
    joints = simulated.get("residual/joints")
    forces, indicators = {}, []
    if robot.force is not None:
        courses = {"estimator": estimator} | ({} if best is estimator else {"twin": best})
        courses |= {"plant": motion} if motion else {}
        t, measured = robot.force.t, robot.force.values
        forces = {
            name: residual(robot.t, pressing(one), robot.sampling.gaps, t, measured) for name, one in courses.items()
        }
        judged = forces.get("twin", forces["estimator"])
        if len(judged.t) < MIN_BASELINE_SAMPLES:
            raise InputRefused(f"{robot.path}: {len(judged.t)} measured forces while the encoders were there; too few")
        rounding = force_rounding(model.belief_with_dead_zone, best["J"], model.resolution)
        bound = rounding.bound if tolerance is None else tolerance
        indicators += _indicator("force", "N", judged.t, judged.r, baseline, bound, rounding.deviation)
    if joints is not None:
        angle = angle_rounding(model.belief_with_dead_zone)
        for i in range(3):
            name, r = f"joint {i + 1}", joints[:, i]
            indicators += _indicator(name, "rad", robot.t, r, baseline, angle.bound, angle.deviation)
    return Replay(model, robot, estimator, best, motion, joints, tuple(followed.starts), forces, tuple(indicators))


def estimates(robot: RobotSamples, model: RobotModel) -> Rows:
    """Estimate position and force over a whole log, as rows of the topics `estimator` and `twin`; see `Estimates`."""
    check = MapCheck(str(robot.path), model.belief, robot.columns)
    rows = Estimates(model, check).feed(robot, {})
    if check.map_error:
        raise LogError(check.map_error)
    return rows


def _indicator(
    name: str, unit: str, t: NDArray[np.float64], r: NDArray[np.float64], baseline: tuple[float, float],
    tolerance: float, deviation: float,
) -> list[Indicator]:  # fmt: skip
    judged = t >= t[0] + baseline[0]
    t, r = t[judged], r[judged]
    found = drift(t, r, baseline[1] - baseline[0], tolerance, deviation) if len(t) else None
    return [Indicator(name, unit, t, r, found)] if found else []


def _refuse_lengths(robot: RobotSamples, baseline: tuple[float, float], tolerance: float | None) -> None:
    if tolerance is not None and not tolerance >= 0.0:
        raise InputRefused(f"--tolerance {tolerance:g}: expected a force >= 0 N")
    span = robot.t[-1] - robot.t[0]
    begin, end = baseline
    after = robot.t - robot.t[0]
    within = int(np.sum((after >= begin) & (after < end)))
    if span <= end or within < MIN_BASELINE_SAMPLES:
        which = f"from {begin:g} to {end:g} s" if begin else f"in the first {end:g} s"
        raise InputRefused(
            f"{robot.path}: {span:.3g} s with {within} samples {which}; expected at least {MIN_BASELINE_SAMPLES} "
            "there and more after them; choose with --baseline S or --baseline FROM:TO"
        )
