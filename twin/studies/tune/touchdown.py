"""Runs of the whole experiment with given gains on each surface, and the goals missed by their measures."""

from collections.abc import Iterator, Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import NamedTuple

from twin.robot.experiment.experiment import Experiment
from twin.robot.run.measures import ROWS_BY_KEY, RunOutcome, Values, missing_measures
from twin.robot.run.runs import RunRequest, Runs
from twin.studies.tune.prediction import LawGains, with_gains

HOLD_OVERSHOOT, HOLD_SETTLING, HOLD_ERROR = JUDGED_MEASURES = "hold_overshoot", "hold_settling_time", "hold_error"
NEVER_TEXT, NONE_TEXT = "never", "none"
"""Text of a force that never settles, and of a measure that does not exist."""
FAILURE_MISS = 10.0
"""Miss of a failed or tripped run, larger than any measure's."""


@dataclass(frozen=True)
class WholeRun:
    """A whole run with given gains: outcome (None: failed), trip reason or "", stiffness (N/m, None: the file's)."""

    drive: str
    outcome: RunOutcome | None
    trip: str
    stiffness: float | None = None

    @property
    def measures(self) -> Values:
        return self.outcome.measures if self.outcome else missing_measures("the run failed")

    def measure_text(self, key: str) -> str:
        """Format a measure of the run: `0.094 N`, `"none"`, or "never" for a settling time."""
        value, reason = self.measures[key].value, self.measures[key].reason
        if value is None:
            return NEVER_TEXT if reason == ROWS_BY_KEY[HOLD_SETTLING].missing else NONE_TEXT
        return ROWS_BY_KEY[key].format_value(value)

    @property
    def name(self) -> str:
        """Name of the run: `the experiment itself with velocity_servo`, `touch-down on 300 N/m with velocity_servo`."""
        where = "the experiment itself" if self.stiffness is None else f"touch-down on {self.stiffness:.4g} N/m"
        return f"{where} with {Path(self.drive).stem}"


def whole_run(experiment: Experiment, drive: str, gains: LawGains, stiffness: float | None = None) -> WholeRun:
    """Simulate an experiment unrecorded with given gains, on another `stiffness` (N/m) without a monitor."""
    if stiffness is not None:
        contact = experiment.contact.model_copy(update={"stiffness": stiffness})
        experiment = replace(experiment, contact=contact, monitor=None)
    done = Runs(RunRequest(tally=True), most=0).run(with_gains(experiment, gains))
    return WholeRun(drive, done.numbers, "" if done.failure else done.reason, stiffness)


def whole_runs(
    experiments: Sequence[Experiment], drives: Sequence[str], gains: LawGains, surfaces: Sequence[float | None]
) -> Iterator[WholeRun]:
    """Yield the run per drive and surface (N/m, None for the file's), simulated when it is requested."""
    for experiment, drive in zip(experiments, drives, strict=True):
        for stiffness in surfaces:
            yield whole_run(experiment, drive, gains, stiffness)


class Shortfall(NamedTuple):
    """A tuning goal missed by a simulated run: size of the miss (larger is worse) and an error message."""

    by: float
    text: str


def shortfalls(before: WholeRun, after: WholeRun, overshoot: float, than: str = "before") -> Iterator[Shortfall]:
    """Yield each tuning goal missed by a simulated run; irrelevant differences do not count.

    On its own surface the experiment must settle and overshoot by at most `overshoot` (share of the force). On another
    surface it may overshoot by that or as much as `before`, the reference run called `than`. The hold error must never
    exceed the one of `before`.
    """
    was, now = before.measures, after.measures

    def grown(key: str) -> bool:
        old, new = was[key].value, now[key].value
        return old is not None and (new is None or (new > old and ROWS_BY_KEY[key].differs(old, new)))

    if after.outcome is None:
        yield Shortfall(FAILURE_MISS, f"{after.name} fails")
        return
    if after.trip:
        yield Shortfall(FAILURE_MISS, f"the safety monitor trips in {after.name}: {after.trip}")
    over, held = now[HOLD_OVERSHOOT].value, now[HOLD_ERROR].value
    its_own = after.stiffness is None or was[HOLD_OVERSHOOT].value is None
    if over is not None and over > overshoot and (its_own or grown(HOLD_OVERSHOOT)):
        text = f"overshoots by {after.measure_text(HOLD_OVERSHOOT)} ({before.measure_text(HOLD_OVERSHOOT)} {than})"
        yield Shortfall(over - overshoot, f"{after.name} {text}")
    if after.stiffness is None and after.measure_text(HOLD_SETTLING) == NEVER_TEXT:
        yield Shortfall(1.0, f"{after.name} never settles within 5 %")
    if grown(HOLD_ERROR):
        text = f"hold error {after.measure_text(HOLD_ERROR)} ({before.measure_text(HOLD_ERROR)} {than})"
        yield Shortfall(FAILURE_MISS if held is None else held, f"{after.name}: {text}")


def price(before: Sequence[WholeRun], after: Iterator[WholeRun], overshoot: float) -> float:
    """Return a penalty of missed goals, 0 .. 1, 0 if all are met; the first run with a miss ends simulation."""
    for i, (old, new) in enumerate(zip(before, after, strict=True)):
        by = sum(one.by for one in shortfalls(old, new, overshoot))
        if by:
            return (len(before) - i - 1 + by / (1.0 + by)) / len(before)
    return 0.0
