"""Runs of the whole experiment with given gains on each surface, and the goals missed by their measures."""

from collections.abc import Iterator, Sequence
from dataclasses import replace
from pathlib import Path
from typing import NamedTuple

from twin.robot.experiment.experiment import Experiment
from twin.robot.run.measures import ROWS_BY_KEY
from twin.robot.run.runs import Outcome, RunRequest, Runs
from twin.studies.tune.prediction import LawGains, with_gains

HOLD_OVERSHOOT, HOLD_SETTLING, HOLD_ERROR = JUDGED_MEASURES = "hold_overshoot", "hold_settling_time", "hold_error"
NEVER_TEXT, NONE_TEXT = "never", "none"
"""Text of a force that never settles, and of a measure that does not exist."""
FAILURE_MISS = 10.0
"""Miss of a failed or tripped run, larger than any measure's."""


class Surface(NamedTuple):
    """Surface for a run of the experiment with a drive; a stiffness (N/m) of None is the file's."""

    drive: str
    stiffness: float | None = None

    @property
    def name(self) -> str:
        """Name of a run: `the experiment itself with velocity_servo`, `touch-down on 300 N/m with velocity_servo`."""
        where = "the experiment itself" if self.stiffness is None else f"touch-down on {self.stiffness:.4g} N/m"
        return f"{where} with {Path(self.drive).stem}"


def measure_text(done: Outcome, key: str) -> str:
    """Format a measure of a run: `0.094 N`, `"none"`, or "never" for a settling time."""
    value, reason = done.measures[key].value, done.measures[key].reason
    if value is None:
        return NEVER_TEXT if reason == ROWS_BY_KEY[HOLD_SETTLING].missing else NONE_TEXT
    return ROWS_BY_KEY[key].format_value(value)


def whole_runs(
    experiments: Sequence[Experiment], gains: LawGains, stiffnesses: Sequence[float | None]
) -> Iterator[Outcome]:
    """Yield each experiment's run on each stiffness (N/m; None for the file's, else without monitor) when requested."""
    runs = Runs(RunRequest(tally=True), most=0)
    for experiment in experiments:
        for stiffness in stiffnesses:
            one = with_gains(experiment, gains)
            if stiffness is not None:
                one = replace(one, contact=one.contact.model_copy(update={"stiffness": stiffness}), monitor=None)
            yield runs.run(one)


class Shortfall(NamedTuple):
    """A tuning goal missed by a simulated run: size of the miss (larger is worse) and an error message."""

    by: float
    text: str


def shortfalls(
    where: Surface, before: Outcome, after: Outcome, overshoot: float, than: str = "before"
) -> Iterator[Shortfall]:
    """Yield each tuning goal missed by a simulated run; irrelevant differences do not count.

    On its own surface the experiment must settle and overshoot by at most `overshoot` (share of the force). On another
    surface it may overshoot by that or as much as `before`, the reference run called `than`. The hold error must never
    exceed the one of `before`.
    """
    was, now = before.measures, after.measures

    def grows(key: str) -> bool:
        old, new = was[key].value, now[key].value
        return old is not None and (new is None or (new > old and ROWS_BY_KEY[key].differs(old, new)))

    def texts(key: str) -> str:
        return f"{measure_text(after, key)} ({measure_text(before, key)} {than})"

    if after.status == "failed":
        yield Shortfall(FAILURE_MISS, f"{where.name} fails")
        return
    if after.status == "tripped":
        yield Shortfall(FAILURE_MISS, f"the safety monitor trips in {where.name}: {after.reason}")
    over, held = now[HOLD_OVERSHOOT].value, now[HOLD_ERROR].value
    its_own = where.stiffness is None or was[HOLD_OVERSHOOT].value is None
    if over is not None and over > overshoot and (its_own or grows(HOLD_OVERSHOOT)):
        yield Shortfall(over - overshoot, f"{where.name} overshoots by {texts(HOLD_OVERSHOOT)}")
    if where.stiffness is None and measure_text(after, HOLD_SETTLING) == NEVER_TEXT:
        yield Shortfall(1.0, f"{where.name} never settles within 5 %")
    if grows(HOLD_ERROR):
        yield Shortfall(FAILURE_MISS if held is None else held, f"{where.name}: hold error {texts(HOLD_ERROR)}")


def price(surfaces: Sequence[Surface], before: Sequence[Outcome], after: Iterator[Outcome], overshoot: float) -> float:
    """Return a penalty of missed goals, 0 .. 1, 0 if all are met; the first run with a miss ends simulation."""
    for i, (where, old, new) in enumerate(zip(surfaces, before, after, strict=True)):
        by = sum(one.by for one in shortfalls(where, old, new, overshoot))
        if by:
            return (len(before) - i - 1 + by / (1.0 + by)) / len(before)
    return 0.0
