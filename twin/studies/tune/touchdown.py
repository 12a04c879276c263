"""The experiment itself with given gains, on each surface, and the goals that its measures miss."""

from collections.abc import Iterator, Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import NamedTuple

from twin.kernel.cosim.observers import simulate
from twin.robot.assembly.assemble import assemble
from twin.robot.experiment.experiment import Experiment
from twin.robot.monitor.component import trip_reason
from twin.robot.run.hold import HoldRequest
from twin.robot.run.measures import MEASURES, Values, unmeasured
from twin.robot.run.outcome import RunOutcome, Tally
from twin.studies.tune.prediction import LawGains, with_gains

OVERSHOOT, SETTLING, HOLD = JUDGED = "hold_overshoot", "hold_settling_time", "hold_error"
"""Measures that goals are set for."""
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
    with assemble(with_gains(experiment, gains)) as assembly:
        tally = Tally(assembly.system, HoldRequest.of(experiment))
        done = simulate(assembly, experiment.duration_ticks, [tally])
    return Whole(drive, None if done.failure else tally.outcome, trip_reason(done.simulation), stiffness)


class Shortfall(NamedTuple):
    """A goal that a run misses: by how much (relative, of the overshoot a share of the force), and a sentence."""

    by: float
    text: str


def shortfalls(before: Whole, after: Whole, overshoot: float, than: str = "before") -> Iterator[Shortfall]:
    """Yield each goal that the run `after` misses.

    The experiment as its file has it overshoots by at most `overshoot` and settles. On other surfaces it overshoots by
    no more than that or than `before`. Nowhere is the hold error larger than `before`. Floors: `Measure.differs`.

    Args:
        before: the run on the same surface with the gains that are compared with.
        after: the run that is judged.
        overshoot: largest overshoot (share of the force).
        than: what sentences call `before`.
    """

    was, now = before.measures, after.measures

    def grown(key: str) -> bool:
        old, new = was[key].value, now[key].value
        return old is not None and new is not None and new > old and MEASURES[key].differs(old, new)

    def told(key: str) -> str:
        old, new = (MEASURES[key].shown(one[key].value or 0.0) for one in (was, now))
        return new if was[key].value is None else f"{new}, {old} {than}"

    if after.outcome is None:
        yield Shortfall(FAILED, f"{after.name} fails")
        return
    if after.trip:
        yield Shortfall(FAILED, f"the safety monitor trips in {after.name}: {after.trip}")
    over, held, old_held = now[OVERSHOOT].value, now[HOLD].value, was[HOLD].value
    free = after.stiffness is not None and was[OVERSHOOT].value is not None
    if over is not None and over > overshoot and (grown(OVERSHOOT) or not free):
        yield Shortfall(over - overshoot, f"{after.name} overshoots by {told(OVERSHOOT)}")
    if after.stiffness is None and now[SETTLING].reason == MEASURES[SETTLING].missing:
        yield Shortfall(1.0, f"{after.name} does not settle: {now[SETTLING].reason}")
    if old_held is not None and held is None:
        yield Shortfall(1.0, f"{after.name} holds no force: {now[HOLD].reason}")
    elif old_held is not None and held is not None and grown(HOLD):
        yield Shortfall(held / old_held - 1.0 if old_held else 1.0, f"{after.name} has a hold error of {told(HOLD)}")


def price(before: Sequence[Whole], after: Iterator[Whole], overshoot: float) -> float:
    """Return how far runs miss their goals; 0 if they meet all. Runs after the first that misses one are not made."""
    for left, (old, new) in zip(range(len(before), 0, -1), zip(before, after, strict=True)):
        missed = [one.by for one in shortfalls(old, new, overshoot)]
        if missed:
            return left + sum(missed)
    return 0.0
