"""A task as data: a table of phases that the compiled machine walks through."""

import math
from enum import IntEnum
from typing import NamedTuple

from twin.cosim.record import record_of


class PhaseKind(IntEnum):
    """What the robot is doing; the words are those of Sec. III.B."""

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
        """For the time line: `build-up`."""
        return self.name.lower().replace("_", "-")


class Until(IntEnum):
    """What ends a phase."""

    ELAPSED = 0
    """its motion has arrived and its duration is over."""
    FELT = 1
    """the pressing force reaches `level`; if the motion arrives without it, `otherwise` follows."""
    TURN = 2
    """the platform will have reached the depth of the pre-defined force by the time a turn takes effect, or the force
    will have reached `level` by then; if the motion arrives without either, `otherwise` follows."""


class Phase(NamedTuple):
    """One phase, SI. Its motion starts wherever the reference is, so a sequence of phases cannot jump.

    Attributes:
        kind: what it is.
        task: which task it belongs to, counted from 1.
        target: end of the straight line (m); NaN keeps a coordinate.
        lift: if > 0, it ends so far (m) above the height at which a probe felt the pre-defined force.
        speed: along the line (m/s).
        ramp_in, ramp_out: time in which it gets there and back to rest (s).
        radius, rate, turns: of a circle about the starting point (m, Hz, 1), with one turn more to spiral out to it and
            one to spiral back; radius 0: a straight line.
        force_on: whether the force loop acts.
        F_end: where its reference goes within `duration` (N).
        duration: shortest time it takes (s).
        period: it ends this long after the last tap began (s), if > 0.
        until: what ends it.
        level: force that does (N).
        next, otherwise: index of the phase that follows, and of the one that does if `until` never comes, or if contact
            is lost while the force loop acts.
        again, times: `next` is taken after `times` passes, `again` before.
    """

    kind: PhaseKind
    task: int
    target: tuple[float, float, float] = (math.nan, math.nan, math.nan)
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
    until: Until = Until.ELAPSED
    level: float = 0.0
    next: int = 0
    otherwise: int = 0
    again: int = 0
    times: int = 1


PHASE = record_of(Phase)
