"""Search for the fastest gains that meet the goals at every corner, and their confirmation in the co-simulation.

The search is a differential evolution, Storn and Price (1997, J Global Optimization 11:341): it needs no derivatives,
which the goals do not have, and is reproducible with a seed. It compares gains rounded to three digits, as written. The
co-simulation with the real drives then simulates a step at each corner and the experiment itself on each surface.
"""

import math
from collections.abc import Callable, Iterator, Sequence
from dataclasses import asdict, dataclass, replace
from functools import partial
from itertools import count
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
from scipy.optimize import differential_evolution

from twin.kernel.cosim.system import System
from twin.kernel.errors import ComponentFailed, InputRefused
from twin.kernel.serialise import to_dict
from twin.robot.assembly.assemble import FORCE_REFERENCE, assemble
from twin.robot.assembly.declared import TUNABLE_PLACES
from twin.robot.assembly.roles import refuse_third_party_parts
from twin.robot.controller.task_controller import set_hold_point
from twin.robot.experiment.experiment import Experiment
from twin.robot.experiment.schema import WayPoints
from twin.robot.run.measures import with_units
from twin.robot.run.shared_prefix import simulate_variants
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
from twin.studies.tune.touchdown import WholeRun, price, shortfalls, whole_runs

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
        by: relative amount by which it is missed; for the overshoot a share of the step.
        reached: value reached, in the unit of the goal.
    """

    goal: str
    by: float
    reached: float
    at: Prediction


def misses(prediction: Prediction, goals: Goals) -> Iterator[Miss]:
    """Yield each tuning goal that the prediction at a corner misses: stability, margin, overshoot, bandwidth."""
    if not prediction.stable:
        yield Miss("stability", prediction.radius - 1.0, prediction.radius, prediction)
        return
    over = prediction.sensitivity / goals.sensitivity - 1.0
    if over > GOAL_TOLERANCE:
        yield Miss("margin", over, prediction.sensitivity, prediction)
    for law, found in prediction.answers.items():
        if found.overshoot > goals.overshoot + GOAL_TOLERANCE:
            yield Miss("overshoot", found.overshoot - goals.overshoot, found.overshoot, prediction)
        if goals.bandwidth and law == goals.law and found.bandwidth < (1.0 - GOAL_TOLERANCE) * goals.bandwidth:
            yield Miss("bandwidth", 1.0 - found.bandwidth / goals.bandwidth, found.bandwidth, prediction)


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
        for law, found in prediction.answers.items():
            largest[law] = max(largest.get(law, 0.0), found.error)
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

    def judged(tried: LawGains) -> float:
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
        lambda logarithms: judged(gains(logarithms)),
        bounds,
        seed=SEARCH_SEED,
        popsize=POPULATION_PER_GAIN,
        maxiter=MAX_GENERATIONS,
        tol=1e-3,
        polish=False,
        init="sobol",
        callback=lambda intermediate_result: progress(next(generations) / MAX_GENERATIONS),
    )
    return start if judged(start) <= found.fun else gains(found.x)


@dataclass(frozen=True)
class StepTrial:
    """A step response simulated at one corner in the co-simulation.

    Attributes:
        law: law whose reference was stepped.
        t, share: time since the step (s) (n,), and response (n,), 1 at the final value of the linear model.
        answer: summary of the response; its bandwidth is NaN if the response does not settle in `STEP_HORIZON`.
        swing: lasting oscillation of the run with the step: peak to peak about a straight line (share of the step).
    """

    corner: Corner
    law: str
    t: Matrix
    share: Matrix
    answer: StepAnswer
    swing: float

    JSON_KEYS = "law overshoot=answer.overshoot settling=answer.settling bandwidth=answer.bandwidth swing"


def can_simulate_step(corner: Corner) -> bool:
    """Whether a step can be simulated: [controller.damping] is only for tasks, and tasks make no steps."""
    damping = corner.experiment.controller.damping if corner.experiment.tasks else None
    return corner.point.in_contact == corner.point.force_on and (damping is None or damping.gain == 0.0)


def step_trial(corner: Corner, gains: LawGains) -> StepTrial | None:
    """Simulate the response of the true force or height to a step of its reference; None if the run failed.

    The same run without the step is subtracted to cancel their common motion, the initial sagging.

    Args:
        gains: gains that keep the linear model stable.
    """
    try:
        still, moved = paired_step_runs(corner, gains)
    except ComponentFailed:
        return None
    i = 3 if corner.point.force_on else 2
    size = FORCE_STEP * corner.point.F_z if corner.point.force_on else HEIGHT_STEP
    end = size * step_response(corner, gains, i)[2]
    share = (moved - still) / end
    tick = corner.experiment.cosim.tick
    t = tick * np.arange(len(share), dtype=np.float64)
    found = answer(t, share, step_bandwidth(share, tick))
    if math.isinf(found.settling):
        found = replace(found, bandwidth=math.nan)
    return StepTrial(corner, corner.laws[0], t, share, found, lasting_swing(t, moved / end))


def step_bandwidth(share: Matrix, tick: float) -> float:
    """Return the bandwidth (rad/s) of a step response, from the spectrum of its impulse response.

    It is the frequency where the spectrum first falls below 1/sqrt(2).

    Args:
        share: response to a unit step (n,), 1 at its end.
        tick: sampling period (s).
    """
    spectrum = np.abs(np.fft.rfft(np.diff(share, prepend=0.0), SPECTRUM_SAMPLES))
    return float(np.argmax(spectrum < HALF_POWER) * 2.0 * np.pi / (SPECTRUM_SAMPLES * tick))


def lasting_swing(t: Matrix, y: Matrix) -> float:
    """Return the peak-to-peak oscillation at the end of a signal, about a straight line that models creep."""
    last = slice(-round(END_SHARE * len(y)), None)
    return float(np.ptp(y[last] - np.polyval(np.polyfit(t[last], y[last], 1), t[last])))


def paired_step_runs(corner: Corner, gains: LawGains) -> list[Matrix]:
    """Return force (N) or height (m) per tick, without and with the step, from the time of the step on."""
    experiment, point = with_gains(at_stiffness(corner), gains), corner.point
    period = experiment.controller.period
    low, high = (1.0 - 0.5 * FORCE_STEP) * point.F_z, (1.0 + 0.5 * FORCE_STEP) * point.F_z
    c = experiment.controller
    force = c.force.model_copy(update={"reference": low, "trigger": None, "trigger_time": 0.0})
    mode = "force_position" if point.force_on else "position"
    held = replace(
        experiment,
        tasks=(),
        approach=None,
        # The last call of the controller before REST_TIME still has the old reference.
        reference=WayPoints((0.0, REST_TIME - period, REST_TIME), (point.p_B,) * 3),
        controller=c.model_copy(update={"mode": mode, "force": force, "tissue": None, "breath": None}),
    )

    def step(system: System) -> None:
        if point.force_on:
            memory = TUNABLE_PLACES[FORCE_REFERENCE].memory_of(system.component("controller"))
            assert memory is not None
            memory[...] = high
        else:
            set_hold_point(system, [*point.p_B[:2], point.p_B[2] + HEIGHT_STEP])

    rest, over = (round(time / experiment.cosim.tick) for time in (REST_TIME, STEP_HORIZON))
    pressed, risen = "plant.F_ee_B", "plant.p_B"
    runs = simulate_variants(partial(assemble, held), rest, rest + over, (pressed, risen), [lambda system: None, step])
    traces = [trace for done, trace in runs if done.require_success()]
    return [-run[pressed][rest:, 2] if point.force_on else run[risen][rest:, 2] for run in traces]


def contradiction(trial: StepTrial, prediction: Prediction, goals: Goals) -> str:
    """Describe how a simulated step violates goals that the linear model meets; "" if it does not."""
    simulated, linear = trial.answer, prediction.answers[trial.law]
    if trial.swing > MAX_SWING:
        return f"the co-simulation never settles; it swings by {100.0 * trial.swing:.0f} % of the step"
    if simulated.overshoot > goals.overshoot + OVERSHOOT_TOLERANCE:
        return f"the co-simulation overshoots by {100.0 * simulated.overshoot:.0f} %"
    if math.isinf(simulated.settling) and SETTLING_FACTOR * linear.settling < STEP_HORIZON:
        within = f"within {100.0 * SETTLED_BAND:g} % of its end"
        return f"the co-simulation is not {within} after {STEP_HORIZON:g} s; predicted are {linear.settling:.2g} s"
    if goals.bandwidth and trial.law == goals.law:
        # A goal that is predicted to be missed is reported as such.
        expected = min(goals.bandwidth, linear.bandwidth)
        if simulated.bandwidth < (1.0 - BANDWIDTH_TOLERANCE) * expected:
            return f"the co-simulation has a bandwidth of {simulated.bandwidth / (2.0 * math.pi):.3g} Hz only"
    return ""


@dataclass(frozen=True)
class GainAssessment:
    """Assessment of some gains at every corner: predictions, missed goals, simulations.

    Attributes:
        predictions: predictions of the linear model, one per corner.
        misses: worst miss of each missed goal.
        trials: corner number -> simulated step, None if the run failed. A corner predicted to be unstable is not
            simulated.
        wholes: runs of the experiment itself with each drive: on the surface of the file, then on each stiffness.
    """

    gains: LawGains
    predictions: list[Prediction]
    misses: list[Miss]
    trials: dict[int, StepTrial | None]
    wholes: list[WholeRun]


@dataclass(frozen=True)
class TuningResult:
    """Result of tuning an experiment's gains for given goals.

    Attributes:
        experiments: experiments, one per drive.
        stiffness: stiffness range (N/m); None for the stiffness of the experiment.
        drives: identified drives, one linearisation per experiment.
        problems: error messages of points without a linear model.
        before, after: assessment of the experiment's own gains, and of the best.
    """

    experiments: list[Experiment]
    goals: Goals
    stiffness: tuple[float, float] | None
    drives: list[Linearisation]
    problems: list[str]
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
        for before, after in zip(self.before.wholes, self.after.wholes, strict=True):
            doubts += [missed.text for missed in shortfalls(before, after, self.goals.overshoot)]
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
            "before": _assessment_facts(self.before),
            "after": _assessment_facts(self.after),
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
        stiffness: stiffness range of the contact (N/m).
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

    surfaces = (None, *(stiffnesses(stiffness) if stiffness else ()))
    labels = [drive.labels[0] for drive in drives]

    def wholes(gains: LawGains) -> Iterator[WholeRun]:
        return whole_runs(experiments, labels, gains, surfaces)

    before = list(wholes(start))

    def simulated(gains: LawGains) -> float:
        return price(before, wholes(gains), goals.overshoot) if law == "force" else 0.0

    after = best_gains(
        found, goals, start, simulated=simulated, progress=lambda done: say("searching gains", SEARCH_SHARE * done)
    )
    predictions = [predict(corner, after) for corner in found]
    tried = [i for i in worst_places(predictions) if can_simulate_step(found[i])]
    say("trying them in the co-simulation", SEARCH_SHARE)
    judged = [
        _assess(found, goals, gains, tried, runs) for gains, runs in ((start, before), (after, list(wholes(after))))
    ]
    return TuningResult(list(experiments), goals, stiffness, drives, problems, *judged)


def _place_text(prediction: Prediction) -> str:
    return f"{prediction.corner.name} with {Path(prediction.corner.drive).stem}"


def worst_places(predictions: Sequence[Prediction]) -> list[int]:
    """Return the corner with the largest M_s per drive, law and stiffness; by drive, air first, stiffness."""
    worst: dict[tuple[str, str, bool, float], int] = {}
    for i, prediction in enumerate(predictions):
        corner = prediction.corner
        key = (corner.drive, corner.laws[0], corner.point.in_contact, corner.point.parameters.K)
        if key not in worst or prediction.sensitivity > predictions[worst[key]].sensitivity:
            worst[key] = i
    drives = list(dict.fromkeys(drive for drive, *_ in worst))
    return [worst[key] for key in sorted(worst, key=lambda key: (drives.index(key[0]), *key[2:], key[1]))]


def _assess(
    found: list[Corner], goals: Goals, gains: LawGains, tried: list[int], wholes: list[WholeRun]
) -> GainAssessment:
    predictions = [predict(corner, gains) for corner in found]
    trials = {i: step_trial(found[i], gains) for i in tried if predictions[i].stable}
    return GainAssessment(gains, predictions, worst_misses(predictions, goals), trials, wholes)


def _assessment_facts(judged: GainAssessment) -> dict[str, Any]:
    return {
        "gains": judged.gains._asdict(),
        "corners": [_corner_facts(prediction, judged.trials.get(i)) for i, prediction in enumerate(judged.predictions)],
        "runs": [_run_facts(whole) for whole in judged.wholes if whole.stiffness is None],
        "touch_downs": [
            {"stiffness": whole.stiffness, **_run_facts(whole)}
            for whole in judged.wholes
            if whole.stiffness is not None
        ],
    }


def _run_facts(whole: WholeRun) -> dict[str, Any]:
    return {
        "drive": whole.drive,
        "force_error": whole.outcome and whole.outcome.force_error,
        "z_error": whole.outcome and whole.outcome.z_error,
        "trip": whole.trip,
        "measures": with_units(whole.measures),
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
        "predicted": prediction.answers,
        "simulated": trial,
    })  # fmt: skip
