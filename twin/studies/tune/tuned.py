"""Gains for goals: before and after, as the linear model predicts and as the co-simulation does."""

from collections.abc import Sequence
from dataclasses import asdict, dataclass, replace
from pathlib import Path
from typing import Any

from twin.errors import InputRefused
from twin.experiment.experiment import Experiment
from twin.runs.assembly.roles import refuse_other_parts
from twin.studies.analyse.linear_point import Linearised
from twin.studies.steps import Say, silent
from twin.studies.tune.corner import Corner, corners
from twin.studies.tune.gains import LawGains, gains_of
from twin.studies.tune.goals import Goals
from twin.studies.tune.prediction import Prediction, StepAnswer, confirmed, predicted
from twin.studies.tune.search import Miss, best_gains, worst_misses
from twin.studies.tune.trial import StepTrial, Whole, can_be_tried, contradiction, step_trial, whole_run
from twin.writing import finite

SEARCH = 0.8
"""Share of the time that the search takes; the rest is tried in the co-simulation."""


@dataclass(frozen=True)
class Judged:
    """Gains, judged at every corner.

    Attributes:
        gains: which.
        predictions: of the linear model.
        misses: goals that they miss, each where it is missed most.
        trials: simulated steps by the number of the corner; None: the run failed. A corner that is predicted to be
            unstable is not tried.
        wholes: the experiment itself, with each drive.
    """

    gains: LawGains
    predictions: list[Prediction]
    misses: list[Miss]
    trials: dict[int, StepTrial | None]
    wholes: list[Whole]


@dataclass(frozen=True)
class Tuned:
    """What tuning came to.

    Attributes:
        experiments: one per drive.
        goals: asked for.
        stiffness: range (N/m), None: that of the experiment.
        drives: as identified, one per experiment.
        problems: sentences about points that have no linear model.
        before, after: the experiment's own gains, and the best.
    """

    experiments: list[Experiment]
    goals: Goals
    stiffness: tuple[float, float] | None
    drives: list[Linearised]
    problems: list[str]
    before: Judged
    after: Judged

    @property
    def contradictions(self) -> list[str]:
        """What the co-simulation does not confirm of the gains found, one sentence each."""
        told = []
        for prediction in self.after.predictions:
            M_s = prediction.sensitivity
            if prediction.stable and not confirmed(prediction.corner, self.after.gains, M_s):
                told.append(f"{_where(prediction)}: the eigenvalues do not bear out its M_s of {M_s:.3g}")
        for i, trial in self.after.trials.items():
            prediction = self.after.predictions[i]
            doubt = "the co-simulation failed" if trial is None else contradiction(trial, prediction, self.goals)
            if doubt:
                told.append(f"{_where(prediction)}: {doubt}")
        for whole in self.after.wholes:
            if whole.outcome is None:
                told.append(f"the experiment itself fails with {whole.drive}")
            elif whole.trip:
                told.append(f"the safety monitor trips in the experiment itself with {whole.drive}: {whole.trip}")
        return told

    @property
    def met(self) -> bool:
        return not self.after.misses and not self.contradictions

    def facts(self) -> dict[str, Any]:
        """For JSON, SI."""
        return {
            "experiment": self.experiments[0].name,
            "met": self.met,
            "goals": {**asdict(self.goals), "stiffness": self.stiffness},
            "missed": [miss.goal for miss in self.after.misses],
            "contradictions": self.contradictions,
            "without_linear_model": self.problems,
            "before": _facts(self.before),
            "after": _facts(self.after),
        }


def tuned(
    experiments: Sequence[Experiment],
    goals: Goals,
    stiffness: tuple[float, float] | None = None,
    say: Say = silent,
) -> Tuned:
    """The fastest gains of the laws of `experiments` that meet `goals` at every corner, and what they were.

    Args:
        experiments: the same experiment with each drive for which the gains have to do, at least one.
        goals: `law` is filled in.
        stiffness: range of the contact's (N/m).
        say: told what is being done.

    Raises:
        InputRefused: goals that nothing can meet, gains that are not tuned, no linear model.
        ComponentFailed: a drive failed while it was measured.
    """
    first = experiments[0]
    refuse_other_parts(first, "twin tune", ("controller", "estimator"))
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
            f"{first.name}: a range of stiffness is given, but nothing is pressed on; leave --stiffness-N-per-m out"
        )
    law = "force" if any(corner.point.force_on for corner in found) else "position"
    goals = replace(goals, law=law)
    after = best_gains(found, goals, start, told=lambda done: say("searching gains", SEARCH * done))
    predictions = [predicted(corner, after) for corner in found]
    tried = [i for i in worst_places(predictions) if can_be_tried(found[i])]
    say("trying them in the co-simulation", SEARCH)
    judged = [_judged(experiments, found, drives, goals, gains, tried) for gains in (start, after)]
    return Tuned(list(experiments), goals, stiffness, drives, problems, *judged)


def _where(prediction: Prediction) -> str:
    return f"{prediction.corner.name} with {Path(prediction.corner.drive).stem}"


def worst_places(predictions: Sequence[Prediction]) -> list[int]:
    """Numbers of the corners that stand for all: for each drive, law and stiffness the place of largest M_s.

    In the order of the drives, in air first, then by stiffness.
    """
    worst: dict[tuple[str, str, bool, float], int] = {}
    for i, prediction in enumerate(predictions):
        corner = prediction.corner
        key = (corner.drive, corner.laws[0], corner.point.in_contact, corner.point.parameters.K)
        if key not in worst or prediction.sensitivity > predictions[worst[key]].sensitivity:
            worst[key] = i
    drives = list(dict.fromkeys(drive for drive, *_ in worst))
    return [worst[key] for key in sorted(worst, key=lambda key: (drives.index(key[0]), *key[2:], key[1]))]


def _judged(
    experiments: Sequence[Experiment],
    found: list[Corner],
    drives: list[Linearised],
    goals: Goals,
    gains: LawGains,
    tried: list[int],
) -> Judged:
    predictions = [predicted(corner, gains) for corner in found]
    trials = {i: step_trial(found[i], gains) for i in tried if predictions[i].stable}
    wholes = [whole_run(e, drive.labels[0], gains) for e, drive in zip(experiments, drives, strict=True)]
    return Judged(gains, predictions, worst_misses(predictions, goals), trials, wholes)


def _facts(judged: Judged) -> dict[str, Any]:
    return {
        "gains": judged.gains._asdict(),
        "corners": [_corner_facts(prediction, judged.trials.get(i)) for i, prediction in enumerate(judged.predictions)],
        "runs": [
            {
                "drive": whole.drive,
                "force_error": whole.outcome and whole.outcome.force_error,
                "z_error": whole.outcome and whole.outcome.z_error,
                "trip": whole.trip,
            }
            for whole in judged.wholes
        ],
    }


def _corner_facts(prediction: Prediction, trial: StepTrial | None) -> dict[str, Any]:
    point = prediction.corner.point
    return finite({
        "drive": prediction.corner.drive,
        "p_B": point.p_B,
        "F_z": point.F_z,
        "stiffness": point.parameters.K if point.in_contact else None,
        "stable": prediction.stable,
        "sensitivity": prediction.sensitivity,
        "predicted": {law: _answer_facts(found) for law, found in prediction.answers.items()},
        "simulated": trial and {"law": trial.law, **_answer_facts(trial.answer), "swing": trial.swing},
    })  # fmt: skip


def _answer_facts(found: StepAnswer) -> dict[str, float]:
    return {key: getattr(found, key) for key in ("overshoot", "settling", "bandwidth")}
