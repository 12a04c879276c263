"""A number that an experiment comes to, and how far it may move before that is said.

The same program gives the same bytes on the same machine. Another one's mathematical library rounds otherwise, which an
encoder may turn into a count here and there: over a whole response well below 2 % of a number. Of a number near zero a
share says nothing, so each has a floor as well, of what counts can do to it: one controller period of a time, 2 mN, 2
um.
"""

from dataclasses import dataclass
from typing import Literal

SHARE = 0.02
FLOORS = {"s": 2e-3, "m": 2e-6, "N": 2e-3, "rad": 5e-5, "rad/s": 1e-3, "m/s": 2e-6, "N m": 1e-4, "J": 1e-4, "1": 2e-3}
"""By SI unit. An angle's is 2 um at a link of 60 mm; of energies a tenth of a millijoule; of shares 0.2 %."""

Sense = Literal["less", "nearer zero", "none"]


@dataclass(frozen=True)
class Metric:
    """A measured number.

    Attributes:
        value: in `unit`, SI.
        floor: the least that its bound may be.
        sense: what is better: less of it, a value nearer to zero, or neither.
        scale: what its share is of, in `unit`; None: of the value, which for a coordinate would mean nothing.
    """

    value: float
    unit: str
    floor: float
    sense: Sense = "less"
    scale: float | None = None

    @property
    def bound(self) -> float:
        """How far it may be off by default."""
        return max(SHARE * abs(self.value if self.scale is None else self.scale), self.floor)


def floor_of(unit: str) -> float:
    """The floor of a number in `unit`; 0 where only a share counts."""
    return FLOORS.get(unit, 0.0)
