"""Search for the fastest gains that meet the goals at every corner, and their confirmation in the co-simulation.

The search is a differential evolution, Storn and Price (1997, J Global Optimization 11:341): it needs no derivatives,
which the goals do not have, and is reproducible with a seed. It compares gains rounded to three digits, as written. The
co-simulation with the real drives then simulates a step at each corner and the experiment itself on each surface.
"""

import math
from collections.abc import Callable, Iterator, Sequence
from dataclasses import asdict, dataclass, replace
from itertools import count
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
from scipy.optimize import differential_evolution

from twin.kernel.errors import ComponentFailed, InputRefused
from twin.kernel.serialise import to_dict
from twin.robot.assembly.assemble import FORCE_REFERENCE
from twin.robot.assembly.roles import refuse_third_party_parts
from twin.robot.experiment.experiment import Experiment
from twin.robot.experiment.schema import Change, WayPoints
from twin.robot.run.measures import with_units
from twin.robot.run.runs import Outcome, RunRequest, Runs
from twin.studies.analyse.linear.loops import Matrix
from twin.studies.analyse.linearised import Linearisation
from twin.studies.command import Say, ignore_progress
from twin.studies.tune.prediction import (
    HALF_POWER,
    SETTLED_BAND,
    STEP_HORIZON,
    Corner,
    Goals,
    LawGains,
    Prediction,
    StepAnswer,
    answer,
    at_stiffness,
    confirms_sensitivity,
    corners,
    gains_of,
    predict,
    round_gains,
    step_response,
    stiffnesses,
    with_gains,
)
from twin.studies.tune.touchdown import Surface, price, shortfalls, whole_runs

SEARCH_SEED = 1
POPULATION_PER_GAIN, MAX_GENERATIONS = 8, 40
"""Population per gain, maximum generations; on Fig. 4's experiment 25 end up to 15 % slower, 60 not faster."""
GAIN_BOUNDS = ((0.1, 200.0), (1e-6, 0.1), (1e-5, 1.0))
"""Search range of each gain: kp (1/s), force_kp (m/N), force_ki (m/(N s))."""
GOAL_TOLERANCE = 1e-3
"""Relative amount by which a missed goal still counts as met; for the overshoot, as a share of the step."""
MISS_PRICES = {"bandwidth": 1e2, "run": 5e3, "overshoot": 1e4, "margin": 1e4, "stability": 1e8}
"""Penalties of missed goals, each larger than any cost of slowness; safety goals rank above bandwidth. The penalty of a
run is below the linear model's penalties, since only gains without those are simulated: a larger one would make the
search avoid runs.
"""


Progress = Callable[[float], None]
REST_TIME = 3.0
"""Time (s) before the step, during which the platform sags under the drives' droop."""
FORCE_STEP = 0.4
"""Step of the force by the corner's force: well above the effect of encoder counts and backlash (0.05 N)."""
HEIGHT_STEP = 1e-3
"""Step of z (m), upwards."""
END_SHARE = 0.25
"""Share of the samples after the step, at their end, that is searched for a lasting oscillation."""
SPECTRUM_SAMPLES = 2**18
"""Length of the zero-padded FFT of the step (samples): frequencies 0.01 Hz apart."""
OVERSHOOT_TOLERANCE = 0.05
"""Tolerance on the overshoot of a simulated step (share of the step): backlash and encoder counts are not linear."""
MAX_SWING = 0.1
"""Peak-to-peak amplitude (share of the step) above which a lasting simulated oscillation is reported."""
SETTLING_FACTOR = 4.0 / 3.0
"""Factor of the settling delay by backlash and counts; a predicted time must show within `STEP_HORIZON`."""
BANDWIDTH_TOLERANCE = 0.1
"""Tolerance on the simulated bandwidth (share of the requested one)."""
SEARCH_SHARE = 0.8
"""Share of the time that the search takes, for the progress report; the rest is the confirmation."""


class Miss(NamedTuple):
    """A tuning goal missed by some gains at one corner.

    Attributes:
        goal: "margin", "overshoot", "bandwidth" or "stability".
        by: relative amount, for the overshoot a share of the step.
        reached: value reached, in the unit of the goal.
    """

    goal: str
    by: float
    reached: float
    at: Prediction


def misses(prediction: Prediction, goals: Goals) -> Iterator[Miss]:
    """Yield each tuning goal that the prediction at a corner misses: stability, margin, overshoot, bandwidth."""
    found = prediction.answer
    if found is None:
        yield Miss("stability", prediction.radius - 1.0, prediction.radius, prediction)
        return
    over = prediction.sensitivity / goals.sensitivity - 1.0
    if over > GOAL_TOLERANCE:
        yield Miss("margin", over, prediction.sensitivity, prediction)
    if found.overshoot > goals.overshoot + GOAL_TOLERANCE:
        yield Miss("overshoot", found.overshoot - goals.overshoot, found.overshoot, prediction)
    asked = goals.bandwidth if prediction.corner.law == goals.law else None
    if asked and found.bandwidth < (1.0 - GOAL_TOLERANCE) * asked:
        yield Miss("bandwidth", 1.0 - found.bandwidth / asked, found.bandwidth, prediction)


def worst_misses(predictions: Sequence[Prediction], goals: Goals) -> list[Miss]:
    worst: dict[str, Miss] = {}
    for prediction in predictions:
        for miss in misses(prediction, goals):
            if miss.goal not in worst or miss.by > worst[miss.goal].by:
                worst[miss.goal] = miss
    return list(worst.values())


def cost(predictions: Sequence[Prediction], goals: Goals) -> float:
    """Compute the cost of gains from their predictions: penalties of missed goals plus log of the integrated errors.

    The settling time is not used: it would reward a P law that jumps into its band and never reaches the end.
    """
    price = sum(MISS_PRICES[miss.goal] * (1.0 + miss.by) for miss in worst_misses(predictions, goals))
    largest: dict[str, float] = {}
    for prediction in predictions:
        if prediction.answer is not None:
            law = prediction.corner.law
            largest[law] = max(largest.get(law, 0.0), prediction.answer.error)
    # Differences below a millisecond do not count.
    return price + sum(math.log(max(error, 1e-3)) for error in largest.values())


def best_gains(
    corners: Sequence[Corner],
    goals: Goals,
    start: LawGains,
    laws: str = "both",
    allowed: Callable[[LawGains], bool] = lambda gains: True,
    simulated: Callable[[LawGains], float] = lambda gains: 0.0,
    progress: Progress = lambda done: None,
) -> LawGains:
    """Search for the gains of least cost by differential evolution; return `start` if it is not improved.

    Args:
        laws: "both", or "force" to keep kp of the position law as in `start`.
        allowed: function that returns whether gains are admissible.
        simulated: function that returns the penalty of gains in the co-simulation, 0 .. 1. Called only if the linear
            model meets the goals with less cost than the best gains so far that meet both.
        progress: callback, called after each generation with the finished share of the longest search, 0 .. 1.
    """
    force = any(corner.point.force_on for corner in corners)
    first, last = (1 if laws == "force" else 0), (len(GAIN_BOUNDS) if force else 1)
    bounds = [(math.log10(low), math.log10(high)) for low, high in GAIN_BOUNDS[first:last]]

    def gains(logarithms: np.ndarray) -> LawGains:
        return round_gains(LawGains(*start[:first], *(float(10.0**x) for x in logarithms), *start[last:]))

    best = MISS_PRICES["overshoot"]

    def penalty(tried: LawGains) -> float:
        nonlocal best
        predictions = []
        if not allowed(tried):
            return 2.0 * MISS_PRICES["stability"]
        for corner in corners:
            predictions.append(predict(corner, tried))
            if not predictions[-1].stable:
                break
        total = cost(predictions, goals)
        if total < best:
            total += MISS_PRICES["run"] * simulated(tried)
            best = min(best, total)
        return total

    generations = count(1)
    found = differential_evolution(
        lambda logarithms: penalty(gains(logarithms)),
        bounds,
        seed=SEARCH_SEED,
        popsize=POPULATION_PER_GAIN,
        maxiter=MAX_GENERATIONS,
        tol=1e-3,
        polish=False,
        init="sobol",
        callback=lambda intermediate_result: progress(next(generations) / MAX_GENERATIONS),
    )
    return start if penalty(start) <= found.fun else gains(found.x)


@dataclass(frozen=True)
class StepTrial:
    """A step response simulated at one corner in the co-simulation.

    Attributes:
        t, share: time since the step (s) (n,), and response (n,), 1 at the final value of the linear model.
        answer: summary of the response; its bandwidth is NaN if the response does not settle in `STEP_HORIZON`.
        swing: lasting oscillation of the run with the step: peak to peak about a straight line (share of the step).
    """

    corner: Corner
    t: Matrix
    share: Matrix
    answer: StepAnswer
    swing: float

    JSON_KEYS = "law=corner.law overshoot=answer.overshoot settling=answer.settling bandwidth=answer.bandwidth swing"


def can_simulate_step(corner: Corner) -> bool:
    """Whether a step can be simulated: [controller.damping] is only for tasks, and tasks make no steps."""
    damping = corner.experiment.controller.damping if corner.experiment.tasks else None
    return corner.point.in_contact == corner.point.force_on and (damping is None or damping.gain == 0.0)


def step_trial(corner: Corner, gains: LawGains) -> StepTrial | None:
    """Simulate the response of the true force or height to a step of its reference; None if the run failed.

    The same run without the step is subtracted to cancel their common motion, the initial sagging. The gains have to
    keep the linear model stable.
    """
    signal, sign, size = ("plant.p_B", 1.0, HEIGHT_STEP)
    if corner.point.force_on:
        signal, sign, size = ("plant.F_ee_B", -1.0, FORCE_STEP * corner.point.F_z)
    runs, tick = Runs(RunRequest(frozenset({signal})), most=0), corner.experiment.cosim.tick
    responses = []
    for experiment in step_experiments(corner, gains):
        try:
            trace = runs.run(experiment).require_success().trace
        except ComponentFailed:
            return None
        assert trace is not None
        responses.append(sign * trace[signal][round(REST_TIME / tick) :, 2])
    still, moved = responses
    end = size * step_response(corner, gains, corner.axes[-1])[2]
    share = (moved - still) / end
    t = tick * np.arange(len(share), dtype=np.float64)
    found = answer(t, share, step_bandwidth(share, tick))
    if math.isinf(found.settling):
        found = replace(found, bandwidth=math.nan)
    return StepTrial(corner, t, share, found, lasting_swing(t, moved / end))


def step_bandwidth(share: Matrix, tick: float) -> float:
    """Return the bandwidth (rad/s) of a step response `share` (n,), 1 at its end, sampled every `tick` (s).

    It is the frequency where the spectrum of the impulse response first falls below 1/sqrt(2).
    """
    spectrum = np.abs(np.fft.rfft(np.diff(share, prepend=0.0), SPECTRUM_SAMPLES))
    return float(np.argmax(spectrum < HALF_POWER) * 2.0 * np.pi / (SPECTRUM_SAMPLES * tick))


def lasting_swing(t: Matrix, y: Matrix) -> float:
    """Return the peak-to-peak oscillation at the end of a signal, about a straight line that models creep."""
    last = slice(-round(END_SHARE * len(y)), None)
    return float(np.ptp(y[last] - np.polyval(np.polyfit(t[last], y[last], 1), t[last])))


def step_experiments(corner: Corner, gains: LawGains) -> tuple[Experiment, Experiment]:
    """Return the experiment that holds the robot at a corner, without and with a step of the reference."""
    experiment, point = with_gains(at_stiffness(corner), gains), corner.point
    c, tick = experiment.controller, experiment.cosim.tick
    low, high = (1.0 - 0.5 * FORCE_STEP) * point.F_z, (1.0 + 0.5 * FORCE_STEP) * point.F_z
    force = c.force.model_copy(update={"reference": low, "trigger": None, "trigger_time": 0.0})
    mode = "force_position" if point.force_on else "position"
    # No call of the controller is between the last two points.
    hold = WayPoints((0.0, REST_TIME - tick, REST_TIME), (point.p_B,) * 3)
    held = replace(
        experiment,
        tasks=(),
        approach=None,
        reference=hold,
        controller=c.model_copy(update={"mode": mode, "force": force, "tissue": None, "breath": None}),
        duration_ticks=round(REST_TIME / tick) + round(STEP_HORIZON / tick),
    )
    if point.force_on:
        return held, replace(held, changes=(Change(round(REST_TIME / tick), FORCE_REFERENCE, high, high),))
    x, y, z = point.p_B
    return held, replace(held, reference=hold._replace(p=(*hold.p[:2], (x, y, z + HEIGHT_STEP))))


def contradiction(trial: StepTrial, prediction: Prediction, goals: Goals) -> str:
    """Describe how a simulated step violates goals that the linear model meets; "" if it does not."""
    simulated, linear, law = trial.answer, prediction.answer, prediction.corner.law
    assert linear is not None
    if trial.swing > MAX_SWING:
        return f"the co-simulation never settles; it swings by {100.0 * trial.swing:.0f} % of the step"
    if simulated.overshoot > goals.overshoot + OVERSHOOT_TOLERANCE:
        return f"the co-simulation overshoots by {100.0 * simulated.overshoot:.0f} %"
    if math.isinf(simulated.settling) and SETTLING_FACTOR * linear.settling < STEP_HORIZON:
        within = f"within {100.0 * SETTLED_BAND:g} % of its end"
        return f"the co-simulation is not {within} after {STEP_HORIZON:g} s; predicted are {linear.settling:.2g} s"
    if goals.bandwidth and law == goals.law:
        # A goal that is predicted to be missed is reported as such.
        expected = min(goals.bandwidth, linear.bandwidth)
        if simulated.bandwidth < (1.0 - BANDWIDTH_TOLERANCE) * expected:
            return f"the co-simulation has a bandwidth of {simulated.bandwidth / (2.0 * math.pi):.3g} Hz only"
    return ""


@dataclass(frozen=True)
class GainAssessment:
    """Assessment of some gains: predictions per corner, worst miss of each missed goal, simulations.

    Attributes:
        trials: corner number -> simulated step, None if the run failed; only of corners predicted to be stable.
        wholes: runs of the experiment itself, one per surface of the tuning.
    """

    gains: LawGains
    predictions: list[Prediction]
    misses: list[Miss]
    trials: dict[int, StepTrial | None]
    wholes: list[Outcome]


@dataclass(frozen=True)
class TuningResult:
    """Result of tuning an experiment's gains, which had the assessment `before`, for given goals.

    Attributes:
        experiments, drives: the experiment with each drive, and the drive's linearisation.
        stiffness: range (N/m); None for the stiffness of the experiment.
        problems: error messages of points without a linear model.
        surfaces: surfaces of the runs of the experiment itself: per drive the file's surface, then each stiffness.
    """

    experiments: list[Experiment]
    goals: Goals
    stiffness: tuple[float, float] | None
    drives: list[Linearisation]
    problems: list[str]
    surfaces: list[Surface]
    before: GainAssessment
    after: GainAssessment

    @property
    def contradictions(self) -> list[str]:
        doubts = []
        for prediction in self.after.predictions:
            M_s = prediction.sensitivity
            if prediction.stable and not confirms_sensitivity(prediction.corner, self.after.gains, M_s):
                doubts.append(f"{_place_text(prediction)}: the eigenvalues do not confirm its M_s of {M_s:.3g}")
        for i, trial in self.after.trials.items():
            prediction = self.after.predictions[i]
            doubt = "the co-simulation failed" if trial is None else contradiction(trial, prediction, self.goals)
            if doubt:
                doubts.append(f"{_place_text(prediction)}: {doubt}")
        for runs in zip(self.surfaces, self.before.wholes, self.after.wholes, strict=True):
            doubts += [missed.text for missed in shortfalls(*runs, self.goals.overshoot)]
        return doubts

    @property
    def meets_goals(self) -> bool:
        return not self.after.misses and not self.contradictions

    def to_dict(self) -> dict[str, Any]:
        return {
            "experiment": self.experiments[0].name,
            "met": self.meets_goals,
            "goals": {**asdict(self.goals), "stiffness": self.stiffness},
            "missed": [miss.goal for miss in self.after.misses],
            "contradictions": self.contradictions,
            "without_linear_model": self.problems,
            "before": _assessment_facts(self.before, self.surfaces),
            "after": _assessment_facts(self.after, self.surfaces),
        }


def tune_gains(
    experiments: Sequence[Experiment],
    goals: Goals,
    stiffness: tuple[float, float] | None = None,
    say: Say = ignore_progress,
) -> TuningResult:
    """Find the fastest gains of an experiment that meet the goals at every corner; assess old and new gains.

    Args:
        experiments: the same experiment with each drive that the gains must suit, at least one.
        goals: goals; `law` is determined here.
        stiffness: range of the contact's stiffness (N/m).
    """
    first = experiments[0]
    refuse_third_party_parts(first, "twin tune", ("controller", "estimator"))
    if first.controller.force.schedule:
        raise InputRefused(
            f"{first.name}: its gains come from [controller.force] schedule; twin tune finds one set, so "
            "--set controller.force.schedule=[], or --schedule for a schedule"
        )
    goals.refuse_period(first.controller.period)
    start = gains_of(first)
    say("identifying the drives", 0.0)
    found, problems, drives = corners(experiments, stiffness)
    if stiffness is not None and not any(corner.point.in_contact for corner in found):
        raise InputRefused(
            f"{first.name}: a range of stiffness is given, but there is no contact; leave --stiffness-N-per-m out"
        )
    law = "force" if any(corner.point.force_on for corner in found) else "position"
    goals = replace(goals, law=law)

    span = (None, *(stiffnesses(stiffness) if stiffness else ()))
    surfaces = [Surface(drive.labels[0], K) for drive in drives for K in span]
    before = list(whole_runs(experiments, start, span))

    def simulated(gains: LawGains) -> float:
        if law == "position":
            return 0.0
        return price(surfaces, before, whole_runs(experiments, gains, span), goals.overshoot)

    after = best_gains(
        found, goals, start, simulated=simulated, progress=lambda done: say("searching gains", SEARCH_SHARE * done)
    )
    predictions = [predict(corner, after) for corner in found]
    tried = [i for i in worst_places(predictions) if can_simulate_step(found[i])]
    say("trying them in the co-simulation", SEARCH_SHARE)
    own = _assess(found, goals, start, tried, before)
    best = _assess(found, goals, after, tried, list(whole_runs(experiments, after, span)))
    return TuningResult(list(experiments), goals, stiffness, drives, problems, surfaces, own, best)


def _place_text(prediction: Prediction) -> str:
    return f"{prediction.corner.name} with {Path(prediction.corner.drive).stem}"


def worst_places(predictions: Sequence[Prediction]) -> list[int]:
    """Return the corner with the largest M_s per drive, law and stiffness; by drive, air first, stiffness."""
    worst: dict[tuple[str, str, bool, float], int] = {}
    for i, prediction in enumerate(predictions):
        corner = prediction.corner
        key = (corner.drive, corner.law, corner.point.in_contact, corner.point.parameters.K)
        if key not in worst or prediction.sensitivity > predictions[worst[key]].sensitivity:
            worst[key] = i
    drives = list(dict.fromkeys(drive for drive, *_ in worst))
    return [worst[key] for key in sorted(worst, key=lambda key: (drives.index(key[0]), *key[2:], key[1]))]


def _assess(
    found: list[Corner], goals: Goals, gains: LawGains, tried: list[int], wholes: list[Outcome]
) -> GainAssessment:
    predictions = [predict(corner, gains) for corner in found]
    trials = {i: step_trial(found[i], gains) for i in tried if predictions[i].stable}
    return GainAssessment(gains, predictions, worst_misses(predictions, goals), trials, wholes)


def _assessment_facts(judged: GainAssessment, surfaces: Sequence[Surface]) -> dict[str, Any]:
    runs = list(zip(surfaces, judged.wholes, strict=True))
    return {
        "gains": judged.gains._asdict(),
        "corners": [_corner_facts(prediction, judged.trials.get(i)) for i, prediction in enumerate(judged.predictions)],
        "runs": [_run_facts(where, done) for where, done in runs if where.stiffness is None],
        "touch_downs": [
            {"stiffness": where.stiffness, **_run_facts(where, done)} for where, done in runs if where.stiffness
        ],
    }


def _run_facts(where: Surface, done: Outcome) -> dict[str, Any]:
    return {
        "drive": where.drive,
        "force_error": done.numbers and done.numbers.force_error,
        "z_error": done.numbers and done.numbers.z_error,
        "trip": done.reason if done.status == "tripped" else "",
        "measures": with_units(done.measures),
    }


def _corner_facts(prediction: Prediction, trial: StepTrial | None) -> dict[str, Any]:
    point = prediction.corner.point
    return to_dict({
        "drive": prediction.corner.drive,
        "p_B": point.p_B,
        "F_z": point.F_z,
        "stiffness": point.parameters.K if point.in_contact else None,
        "stable": prediction.stable,
        "sensitivity": prediction.sensitivity,
        "predicted": {prediction.corner.law: prediction.answer} if prediction.answer else {},
        "simulated": trial,
    })  # fmt: skip
