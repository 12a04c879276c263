"""Gain schedules over the stiffness of the tissue: design on the linear model per point, simulation, text and TOML."""

import math
from collections.abc import Iterator, Sequence
from dataclasses import dataclass, replace
from functools import partial
from itertools import pairwise
from pathlib import Path
from typing import Any

import numpy as np

from twin.kernel.errors import InputRefused
from twin.robot.assembly.checks.adaptive_loop import believed_loop, spectral_radius
from twin.robot.controller.pid import ScheduledGains
from twin.robot.controller.schedule import SchedulePoint, gains_at, schedule_table
from twin.robot.controller.tissue import Tissue
from twin.robot.experiment.experiment import Experiment
from twin.robot.run.measures import with_units
from twin.robot.run.runs import Outcome
from twin.studies.analyse.operating_point import OperatingPoint, point_on_stiffness
from twin.studies.result import Block, Column, Row, Table
from twin.studies.tune import tuned
from twin.studies.tune.prediction import Corner, Goals, LawGains, Prediction, open_corner, predict, with_gains
from twin.studies.tune.text import goals_sentence, missed_note
from twin.studies.tune.touchdown import HOLD_ERROR, HOLD_OVERSHOOT, Surface, measure_text, price, shortfalls, whole_runs

STIFFNESS_RANGE = (300.0, 5000.0)
"""Default stiffness range (N/m)."""
MAX_STIFFNESS_RATIO = 2.0
STIFFNESS_ERROR_FACTOR = 1.3
"""Factor of the stiffness estimate's error in either direction: the tolerance of [controller.tissue]."""
MAX_ERROR_RATIO = 1.05
"""Ratio of the errors since the first touch, with the schedule to with one set, above which it is reported."""
ONE_SET = "with one set"
"""Name of the reference that a schedule is compared with."""
SCHEDULE_COLUMNS = (
    Column("", 12, unit="on", left=True),
    Column("kp", 6, ".3g", "mm/N", gap=2),
    Column("ki", 9, ".3g", "mm/(N s)"),
    Column("M_s", 4, ".2f", gap=2),
    Column("over", 5),
    Column("5 % in", 7),
    Column("run: overshoot, hold error", unit=f"{'one set':>14} {'scheduled':>14}", left=True, gap=1),
)


@dataclass(frozen=True)
class DesignedPoint:
    """Designed gains of a schedule on one tissue stiffness.

    Attributes:
        predictions: one per pressed place and drive.
        misses: goals missed on this stiffness or on one confused with it.
        trials: number of the prediction -> simulated step, None if the run failed.
        wholes: runs of the experiment itself, per drive: (surface, with the one set of gains, with the schedule).
    """

    stiffness: float
    gains: LawGains
    predictions: list[Prediction]
    misses: list[tuned.Miss]
    trials: dict[int, tuned.StepTrial | None]
    wholes: list[tuple[Surface, Outcome, Outcome]]

    def ratio(self, drive: int) -> float:
        """Return the force error with the schedule, relative to one set of gains; NaN if a run failed."""
        fixed, scheduled = (done.numbers and done.numbers.force_error for done in self.wholes[drive][1:])
        return scheduled / fixed if fixed and scheduled else float("nan")


@dataclass(frozen=True)
class GainSchedule:
    """A designed schedule of gains over the tissue stiffness, with its confirmation in the co-simulation.

    Attributes:
        base: result of tuning one set of gains for all stiffnesses, the safe set.
        points: softest first.
        midpoint_predictions: predictions half-way between neighbouring points.
    """

    base: tuned.TuningResult
    goals: Goals
    points: list[DesignedPoint]
    midpoint_predictions: list[Prediction]

    @property
    def contradictions(self) -> list[str]:
        """Results that the co-simulation does not confirm, and gains unstable between two points."""
        doubts = [
            f"between the points, {prediction.corner.name}: unstable"
            for prediction in self.midpoint_predictions
            if not prediction.stable
        ]
        for point in self.points:
            name = f"on {point.stiffness:.4g} N/m"
            for i, trial in point.trials.items():
                doubt = "the co-simulation failed"
                doubt = doubt if trial is None else tuned.contradiction(trial, point.predictions[i], self.goals)
                doubts += [f"{name}: {doubt}"] if doubt else []
            for drive, runs in enumerate(point.wholes):
                doubts += [one.text for one in shortfalls(*runs, self.goals.overshoot, ONE_SET)]
                if point.ratio(drive) > MAX_ERROR_RATIO:
                    share = f"{100 * point.ratio(drive):.0f} %"
                    doubts.append(f"{runs[0].name}: the error since the first touch is {share} of that {ONE_SET}")
        return doubts

    @property
    def meets_goals(self) -> bool:
        return not self.contradictions and not any(point.misses for point in self.points)

    def to_dict(self) -> dict[str, Any]:
        return {
            "met": self.meets_goals,
            "contradictions": self.contradictions,
            "points": [
                {
                    "stiffness": point.stiffness,
                    "kp": point.gains.force_kp,
                    "ki": point.gains.force_ki,
                    "sensitivity": max(found.sensitivity for found in point.predictions),
                    "overshoot": max(found.answer.overshoot for found in point.predictions if found.answer),
                    "settling": max(found.answer.settling for found in point.predictions if found.answer),
                    "missed": [miss.goal for miss in point.misses],
                    "runs": [
                        {
                            "drive": where.drive,
                            "force_error_one_set": fixed.numbers and fixed.numbers.force_error,
                            "force_error_scheduled": scheduled.numbers and scheduled.numbers.force_error,
                            "measures_one_set": with_units(fixed.measures),
                            "measures_scheduled": with_units(scheduled.measures),
                        }
                        for where, fixed, scheduled in point.wholes
                    ],
                }
                for point in self.points
            ],
        }


def geometric_grid(low: float, high: float) -> list[float]:
    """Return stiffnesses (N/m) between two ends with a constant ratio of at most `MAX_STIFFNESS_RATIO`."""
    steps = max(1, int(np.ceil(np.log(high / low) / np.log(MAX_STIFFNESS_RATIO) - 1e-9)))
    return [float(f"{K:.3g}") for K in np.geomspace(low, high, steps + 1)]


def design_schedule(base: tuned.TuningResult) -> GainSchedule:
    goals, name = base.goals, base.experiments[0].name
    places = _places(base)
    if not places:
        raise InputRefused(f"{name}: no force control in contact, so a schedule over stiffness does not apply")
    low, high = base.stiffness or STIFFNESS_RANGE
    if low == high:
        raise InputRefused(f"--stiffness-N-per-m {low:g}:{high:g}: one stiffness; a schedule needs a range")
    found, fixed = [], []
    for K in geometric_grid(low, high):
        one_set = list(whole_runs(base.experiments, base.after.gains, (K,)))
        surfaces = [Surface(shared.labels[0], K) for shared in base.drives]
        fixed.append((surfaces, one_set))
        mistaken = [
            *_corners(base, places, K / STIFFNESS_ERROR_FACTOR, True),
            *_corners(base, places, K * STIFFNESS_ERROR_FACTOR),
        ]
        designed_for = [*mistaken, *_corners(base, places, K)]

        def simulated(gains: LawGains, surfaces: list[Surface] = surfaces, one_set: list[Outcome] = one_set) -> float:
            runs = whole_runs(base.experiments, gains, (surfaces[0].stiffness,))
            return price(surfaces, one_set, runs, goals.overshoot)

        gains = tuned.best_gains(
            designed_for, goals, base.after.gains, "force", partial(_is_stable, base, K), simulated
        )
        misses = tuned.worst_misses([predict(corner, gains) for corner in designed_for], goals)
        predictions = [predict(corner, gains) for corner in _corners(base, places, K)]
        tried = [i for i, corner in enumerate(predictions) if corner.stable and tuned.can_simulate_step(corner.corner)]
        trials = {i: tuned.step_trial(predictions[i].corner, gains) for i in tried}
        found.append(DesignedPoint(K, gains, predictions, misses, trials, []))
    # Each experiment already has the safe set as its own gains.
    followed = [with_schedule(experiment, base.after.gains, found) for experiment in base.experiments]
    points = []
    for point, (surfaces, one_set) in zip(found, fixed, strict=True):
        runs = whole_runs(followed, base.after.gains, (point.stiffness,))
        points.append(replace(point, wholes=list(zip(surfaces, one_set, runs, strict=True))))
    return GainSchedule(base, goals, points, list(_midpoint_predictions(base, places, found)))


def _is_stable(base: tuned.TuningResult, K: float, gains: LawGains) -> bool:
    """Whether the controller's believed loop with some gains is stable on the tissue stiffness `K` (N/m)."""
    first = with_schedule(base.experiments[0], gains, ())
    loop = believed_loop(first.controller, first.plant, first.start)
    return spectral_radius(loop, K, gains.force_kp, gains.force_ki) < 1.0


def with_schedule(experiment: Experiment, gains: LawGains, points: Sequence[DesignedPoint]) -> Experiment:
    """Return the experiment with a gain schedule, `gains` its safe set; `values` keep the gains of the file."""
    safe = with_gains(experiment, gains)
    c = safe.controller
    table = tuple(
        ScheduledGains.model_construct(stiffness=point.stiffness, kp=point.gains.force_kp, ki=point.gains.force_ki)
        for point in points
    )
    force = c.force.model_copy(update={"schedule": table})
    tissue = c.tissue or Tissue.model_validate({})
    return replace(safe, controller=c.model_copy(update={"force": force, "tissue": tissue}))


def _places(base: tuned.TuningResult) -> list[OperatingPoint]:
    """Return the distinct operating points where the force law acts, for any stiffness."""
    found: dict[tuple[float, ...], OperatingPoint] = {}
    for prediction in base.after.predictions:
        point = prediction.corner.point
        if point.force_on:
            found.setdefault((*point.p_B, round(point.F_z, 6)), point)
    return list(found.values())


def _corners(
    base: tuned.TuningResult, places: Sequence[OperatingPoint], K: float, undamped: bool = False
) -> list[Corner]:
    """Return the models of each point and drive on one stiffness; `undamped` for a tissue that is a pure spring."""
    there = [point_on_stiffness(place, K) for place in places]
    if undamped:
        there = [replace(point, parameters=point.parameters._replace(damping=0.0, damper=0.0)) for point in there]
    return [
        open_corner(experiment, shared, point)
        for experiment, shared in zip(base.experiments, base.drives, strict=True)
        for point in there
    ]


def _midpoint_predictions(
    base: tuned.TuningResult, places: Sequence[OperatingPoint], points: Sequence[DesignedPoint]
) -> list[Prediction]:
    designed = [SchedulePoint(point.stiffness, point.gains.force_kp, point.gains.force_ki) for point in points]
    table = schedule_table(designed).view(np.recarray)
    found = []
    for below, above in pairwise(points):
        K = float(np.sqrt(below.stiffness * above.stiffness))
        gains = LawGains(base.after.gains.kp, *map(float, gains_at(table, 0, K)[:2]))
        found += [predict(corner, gains) for corner in _corners(base, places, K)]
    return found


def schedule_parts(done: GainSchedule) -> list[Block]:
    return [
        *_verdict(done),
        "",
        Table(SCHEDULE_COLUMNS, [row for point in done.points for row in _rows(point)], indent=0),
    ]


def schedule_lines(done: GainSchedule, own_tissue: bool) -> str:
    """Return the TOML of a gain schedule below its safe set; `own_tissue`: [controller.tissue] exists."""
    source = f"twin tune --schedule: {goals_sentence(done.base)}" + ("" if done.meets_goals else "; GOALS NOT MET")
    lines = ["", f"# {source}"]
    for point in done.points:
        lines += [
            "[[controller.force.schedule]]",
            f"stiffness_N_per_m = {point.stiffness:.6g}",
            f"kp_mm_per_N = {1e3 * point.gains.force_kp:.6g}",
            f"ki_mm_per_N_s = {1e3 * point.gains.force_ki:.6g}",
            "",
        ]
    return "\n".join(lines if own_tissue else [*lines, "[controller.tissue]", ""])


def _verdict(done: GainSchedule) -> list[Block]:
    name, points = done.base.experiments[0].name, len(done.points)
    if done.meets_goals:
        return [f"{name}  SCHEDULE of {points} points, goals met at each, and the co-simulation agrees"]
    missed = [
        f"{miss.goal} for {point.stiffness:.4g} N/m: {miss.at.corner.name}"
        for point in done.points
        for miss in point.misses
    ]
    return [
        f"{name}  SCHEDULE of {points} points, GOALS NOT MET; this is the best that was found",
        *map(missed_note, (*missed, *done.contradictions)),
    ]


def _rows(point: DesignedPoint) -> Iterator[Row]:
    gains = (f"{point.stiffness:8.4g} N/m", 1e3 * point.gains.force_kp, 1e3 * point.gains.force_ki)
    answers = [prediction.answer for prediction in point.predictions if prediction.answer]
    if not answers:
        yield f"{gains[0]}  {gains[1]:6.3g} {gains[2]:9.3g}  UNSTABLE"
        return
    M_s = max(prediction.sensitivity for prediction in point.predictions if prediction.stable)
    over, settling = max(found.overshoot for found in answers), max(found.settling for found in answers)
    time = f"{settling:.2f} s" if math.isfinite(settling) else "never"
    own = (*gains, M_s, f"{100 * over:.0f} %", time)
    yield *own, "" if point.wholes[1:] else _pair(*point.wholes[0][1:])
    for where, *runs in point.wholes if point.wholes[1:] else ():
        yield f"    {Path(where.drive).stem}", *6 * ("",), _pair(*runs)


def _pair(*runs: Outcome) -> str:
    return " ".join(f"{measure_text(run, HOLD_OVERSHOOT):>6} {measure_text(run, HOLD_ERROR):>7}" for run in runs)
