"""Tasks of Sec. III.B as tables of phases: approach, descent, force build-up, hold, tap, circle or push, release.

A program is a table of `Phase`s for the whole sequence, which the compiled machine steps through. Each phase begins at
the present reference, so tasks of any order follow one another without a jump.
"""

import math
from collections.abc import Iterable, Sequence
from enum import IntEnum
from typing import Any, Literal, NamedTuple

from pydantic import Field, model_validator

from twin.kernel.cosim.port import record_of
from twin.kernel.settings import Settings, Triple, setting

Point = tuple[float, float]
"""x and y in the base frame (m)."""


class PhaseKind(IntEnum):
    """Kind of a task's phase, such as descent or hold, in the words of Sec. III.B."""

    TRAVEL = 1
    DESCEND = 2
    BUILD_UP = 3
    HOLD = 4
    CIRCLE = 5
    PUSH = 6
    RELEASE = 7
    RETRACT = 8
    PROBE = 9
    TAP = 10
    RISE = 11
    WAIT = 12
    DONE = 13

    @property
    def phrase(self) -> str:
        """Name of the phase kind in events and recordings: lower case with hyphens, for example `build-up`."""
        return self.name.lower().replace("_", "-")


class PhaseEnd(IntEnum):
    """Kind of condition that ends a task's phase."""

    ELAPSED = 0
    """Its motion has arrived and its duration is over."""
    FELT = 1
    """The pressing force reaches `level`; if the motion arrives before, `otherwise` follows."""
    TURN = 2
    """By the time a reversal takes effect, the platform will be at the depth of the pre-defined force, or the force at
    `level`; if the motion arrives before, `otherwise` follows."""


class Phase(NamedTuple):
    """One phase of a massage task, SI: a motion and a force reference with a condition for its end.

    The motion starts at the present reference, so a sequence of phases cannot jump.

    Attributes:
        task: number of its task, from 1.
        target: end of the straight line (m); NaN keeps a coordinate.
        lift: if > 0, end height (m) above the height of a probe at the pre-defined force.
        speed: speed along the line (m/s).
        ramp_in, ramp_out: acceleration and deceleration time (s).
        radius, rate, turns: circle about the starting point (m, Hz, 1), with one more turn to spiral out to it and one
            to spiral back; radius 0 for a straight line.
        force_on: whether the force loop acts.
        F_end: force reference reached within `duration` (N).
        duration: minimum duration (s).
        period: if > 0, the phase ends this long after the last tap began (s).
        until, level: condition that ends it, with its force (N).
        next, otherwise: index of the next phase, and of the one that follows if `until` is never met, or if contact is
            lost while the force loop acts.
        again, times: `next` follows after `times` passes, `again` before.
    """

    kind: PhaseKind
    task: int
    target: Triple = (math.nan, math.nan, math.nan)
    lift: float = 0.0
    speed: float = 0.0
    ramp_in: float = 0.0
    ramp_out: float = 0.0
    radius: float = 0.0
    rate: float = 0.0
    turns: float = 0.0
    force_on: bool = False
    F_end: float = 0.0
    duration: float = 0.0
    period: float = 0.0
    until: PhaseEnd = PhaseEnd.ELAPSED
    level: float = 0.0
    next: int = 0
    otherwise: int = 0
    again: int = 0
    times: int = 1


PHASE_RECORD = record_of(Phase)


class Approach(Settings):
    """[approach]: motion of all tasks to and from the body."""

    height: float = setting("mm", help="z at which the robot travels between tasks, above the surface")
    floor: float = setting("mm", help="z at which a descent without contact ends")
    speed: float = setting("mm/s", gt=0, help="speed of travel between tasks")
    descent: float = setting("mm/s", gt=0, help="speed of the descent to the first contact")
    ramp: float = setting("ms", gt=0, help="time of a change of speed")
    release: float = setting("s", gt=0, help="time in which the force is released")

    @model_validator(mode="after")
    def _floor_is_below(self) -> "Approach":
        if self.floor >= self.height:
            raise ValueError(f"floor_mm = {1e3 * self.floor:g} is not below height_mm = {1e3 * self.height:g}")
        return self


TASK_KIND: Any = Field(description="kind of task")


class TaskOnPoint(Settings):
    """Keys common to all tasks."""

    point: Point = setting("mm", help="position (x, y) in frame B")
    force: float = setting("N", gt=0, help="pressing force")


class Press(TaskOnPoint):
    """[[task]] kind = "press": force on one point, which grows, is held, and is released."""

    kind: Literal["press"] = TASK_KIND
    build_up: float = setting("s", gt=0, help="rise time of the force")
    hold: float = setting("s", gt=0, help="time at full force")


class Tap(TaskOnPoint):
    """[[task]] kind = "tap": repeated fast strokes down to the force and up again."""

    kind: Literal["tap"] = TASK_KIND
    speed: float = setting("mm/s", gt=0, help="speed down and up")
    lift: float = setting("mm", gt=0, help="height above the surface between two taps")
    period: float = setting("s", gt=0, help="time from tap to tap")
    times: int = setting(ge=1, help="number of taps")


class Roll(TaskOnPoint):
    """[[task]] kind = "roll": a small circle under a constant force."""

    kind: Literal["roll"] = TASK_KIND
    build_up: float = setting("s", gt=0, help="rise time of the force")
    radius: float = setting("mm", gt=0, help="radius of the circle")
    rate: float = setting("Hz", gt=0, help="turns per second")
    turns: float = setting(ge=1, help="number of turns")


class Push(TaskOnPoint):
    """[[task]] kind = "push": along a line under a constant force."""

    kind: Literal["push"] = TASK_KIND
    build_up: float = setting("s", gt=0, help="rise time of the force")
    to: Point = setting("mm", help="end of the line (x, y) in frame B")
    speed: float = setting("mm/s", gt=0, help="speed along the line")

    @model_validator(mode="after")
    def _goes_somewhere(self) -> "Push":
        if self.to == self.point:
            raise ValueError("to_mm is point_mm: expected another point, to which to push")
        return self


Task = Press | Tap | Roll | Push
TASK_KINDS: dict[str, type[Task]] = {"press": Press, "tap": Tap, "roll": Roll, "push": Push}
"""Task tables by their key `kind`."""


def program(approach: Approach, contact_force: float, tasks: Sequence[Task]) -> list[Phase]:
    """Convert massage tasks to a table of phases, in order; the last phase stays above the last point for ever.

    `contact_force` is the pressing force that counts as contact (N).
    """
    phases: list[Phase] = []
    for number, task in enumerate(tasks, start=1):
        phases += _task_phases(approach, contact_force, task, number, len(phases))
    return [*phases, Phase(PhaseKind.DONE, len(tasks), duration=math.inf, next=len(phases))]


def _task_phases(approach: Approach, contact_force: float, task: Task, number: int, first: int) -> list[Phase]:
    travel = Phase(
        PhaseKind.TRAVEL, number, (*task.point, approach.height), speed=approach.speed,
        ramp_in=approach.ramp, ramp_out=approach.ramp,
    )  # fmt: skip
    descend = Phase(
        PhaseKind.DESCEND, number, (math.nan, math.nan, approach.floor), speed=approach.descent, ramp_in=approach.ramp,
        until=PhaseEnd.FELT, level=contact_force,
    )  # fmt: skip
    retract = Phase(
        PhaseKind.RETRACT, number, (math.nan, math.nan, approach.height), speed=approach.speed,
        ramp_in=approach.ramp, ramp_out=approach.ramp,
    )  # fmt: skip
    work = (
        _tap_phases(approach, task, number)
        if isinstance(task, Tap)
        else _force_phases(approach, contact_force, task, number)
    )
    chain = [travel, descend, *work, retract]
    last = first + len(chain) - 1
    linked = []
    for index, phase in enumerate(chain, start=first):
        again = index + phase.again if phase.again else index + 1
        linked.append(phase._replace(next=index + 1, otherwise=last, again=again))
    return linked


def _force_phases(approach: Approach, contact_force: float, task: Press | Roll | Push, number: int) -> Iterable[Phase]:
    pressing = Phase(PhaseKind.BUILD_UP, number, force_on=True, F_end=task.force)
    yield pressing._replace(duration=task.build_up)
    match task:
        case Press():
            yield pressing._replace(kind=PhaseKind.HOLD, duration=task.hold)
        case Roll():
            yield pressing._replace(kind=PhaseKind.CIRCLE, radius=task.radius, rate=task.rate, turns=task.turns)
        case Push():
            yield pressing._replace(
                kind=PhaseKind.PUSH, target=(*task.to, math.nan), speed=task.speed,
                ramp_in=approach.ramp, ramp_out=approach.ramp,
            )  # fmt: skip
    yield pressing._replace(kind=PhaseKind.RELEASE, F_end=contact_force, duration=approach.release)


def _tap_phases(approach: Approach, task: Tap, number: int) -> Iterable[Phase]:
    down = Phase(PhaseKind.PROBE, number, (math.nan, math.nan, approach.floor), level=task.force)
    # a gentle probe first: its height at the pre-defined force is the aim of the taps
    yield down._replace(speed=approach.descent, until=PhaseEnd.FELT)
    up = Phase(PhaseKind.RETRACT, number, lift=task.lift, speed=approach.speed, ramp_in=approach.ramp)
    yield up._replace(ramp_out=approach.ramp)
    # a tap reverses at once: a smooth reversal would take longer
    yield down._replace(kind=PhaseKind.TAP, speed=task.speed, ramp_in=approach.ramp, until=PhaseEnd.TURN)
    yield up._replace(kind=PhaseKind.RISE, speed=task.speed, ramp_in=0.0, ramp_out=approach.ramp)
    # `again` is relative until the phases are linked
    yield Phase(PhaseKind.WAIT, number, period=task.period, times=task.times, again=-2)
