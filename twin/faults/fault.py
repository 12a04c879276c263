"""One fault, SI, as `inject` wants it."""

from dataclasses import dataclass

NEVER = 1 << 62
"""The end, in ticks, of a fault that stays."""


@dataclass(frozen=True)
class Fault:
    """What breaks, where, when and how badly.

    Attributes:
        kind: a key of `CATALOGUE`. target: one of that kind's targets.
        onset, end: active in ticks onset <= k < end. Of a continuous component: in the steps that begin at these.
        magnitude: SI (rad, m, s, a share, a factor); 0 where the kind has none.
        share: of an encoder's samples that a glitch hits, 0..1.
        ramp: ticks over which a parameter fault grows from nothing to its magnitude; 0: at once.
        seed: of the random kinds; the same seed gives the same faults.
    """

    kind: str
    target: str
    onset: int
    end: int = NEVER
    magnitude: float = 0.0
    share: float = 0.0
    ramp: int = 0
    seed: int = 0
