"""The experiment itself with given gains, on each surface, and the goals that its measures miss."""

from collections.abc import Iterator, Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import NamedTuple

from twin.robot.experiment.experiment import Experiment
from twin.robot.run.measures import MEASURES, RunOutcome, Values, unmeasured
from twin.robot.run.runs import RunRequest, Runs
from twin.studies.tune.prediction import LawGains, with_gains

OVERSHOOT, SETTLING, HOLD = JUDGED = "hold_overshoot", "hold_settling_time", "hold_error"
"""Measures that goals are set for."""
NEVER, NONE = "never", "none"
"""A force that does not settle; a measure that does not exist."""
FAILED = 10.0
"""How far a run that fails or trips misses its goals: farther than measures do."""


@dataclass(frozen=True)
class Whole:
    """A run of the experiment from beginning to end.

    Attributes:
        drive: name of its drive.
        outcome: None if the run failed.
        trip: reason of a trip of the safety monitor, or "".
        stiffness: of the surface (N/m); None for the one of the file.
    """

    drive: str
    outcome: RunOutcome | None
    trip: str
    stiffness: float | None = None

    @property
    def measures(self) -> Values:
        """Its measures, by their keys in `MEASURES`."""
        return self.outcome.measures if self.outcome else unmeasured("the run failed")

    def shown(self, key: str) -> str:
        """A measure for people: `0.094 N`, "none", or "never" for a settling time."""
        value, reason = self.measures[key].value, self.measures[key].reason
        if value is None:
            return NEVER if reason == MEASURES[SETTLING].missing else NONE
        return MEASURES[key].shown(value)

    @property
    def name(self) -> str:
        """`the experiment itself with velocity_servo`, `touch-down on 300 N/m with velocity_servo`."""
        where = "the experiment itself" if self.stiffness is None else f"touch-down on {self.stiffness:.4g} N/m"
        return f"{where} with {Path(self.drive).stem}"


def whole_run(experiment: Experiment, drive: str, gains: LawGains, stiffness: float | None = None) -> Whole:
    """Simulate `experiment` from beginning to end with `gains`; nothing is recorded.

    Args:
        drive: name of its drive.
        stiffness: of another surface (N/m), which is then pressed without a monitor: soft tissue yields far.
    """
    if stiffness is not None:
        contact = experiment.contact.model_copy(update={"stiffness": stiffness})
        experiment = replace(experiment, contact=contact, monitor=None)
    done = Runs(RunRequest(tally=True), most=0).run(with_gains(experiment, gains))
    return Whole(drive, done.numbers, "" if done.failure else done.reason, stiffness)


def whole_runs(
    experiments: Sequence[Experiment], drives: Sequence[str], gains: LawGains, surfaces: Sequence[float | None]
) -> Iterator[Whole]:
    """Yield `whole_run` of each drive on each surface (stiffness in N/m, None for the one of the file), lazily."""
    for experiment, drive in zip(experiments, drives, strict=True):
        for stiffness in surfaces:
            yield whole_run(experiment, drive, gains, stiffness)


class Shortfall(NamedTuple):
    """A goal that a run misses: how badly (for the search, more is worse), and a sentence."""

    by: float
    text: str


def shortfalls(before: Whole, after: Whole, overshoot: float, than: str = "before") -> Iterator[Shortfall]:
    """Yield each goal that the run `after` misses. Differences below the floors of the measures do not count.

    The experiment as its file has it settles and overshoots by at most `overshoot` (share of the force); on another
    surface by no more than that or than `before`, the run with the gains that are compared with, called `than`.
    Nowhere is the hold error larger than `before`.
    """
    was, now = before.measures, after.measures

    def grown(key: str) -> bool:
        old, new = was[key].value, now[key].value
        return old is not None and (new is None or (new > old and MEASURES[key].differs(old, new)))

    if after.outcome is None:
        yield Shortfall(FAILED, f"{after.name} fails")
        return
    if after.trip:
        yield Shortfall(FAILED, f"the safety monitor trips in {after.name}: {after.trip}")
    over, held = now[OVERSHOOT].value, now[HOLD].value
    its_own = after.stiffness is None or was[OVERSHOOT].value is None
    if over is not None and over > overshoot and (its_own or grown(OVERSHOOT)):
        text = f"overshoots by {after.shown(OVERSHOOT)} ({before.shown(OVERSHOOT)} {than})"
        yield Shortfall(over - overshoot, f"{after.name} {text}")
    if after.stiffness is None and after.shown(SETTLING) == NEVER:
        yield Shortfall(1.0, f"{after.name} never settles within 5 %")
    if grown(HOLD):
        text = f"hold error {after.shown(HOLD)} ({before.shown(HOLD)} {than})"
        yield Shortfall(FAILED if held is None else held, f"{after.name}: {text}")


def price(before: Sequence[Whole], after: Iterator[Whole], overshoot: float) -> float:
    """Return how far runs miss their goals, 0 .. 1; 0 if they meet all. No run follows the first that misses one."""
    for i, (old, new) in enumerate(zip(before, after, strict=True)):
        by = sum(one.by for one in shortfalls(old, new, overshoot))
        if by:
            return (len(before) - i - 1 + by / (1.0 + by)) / len(before)
    return 0.0
