"""What is known of a kind of fault before any of them happens."""

from collections.abc import Mapping
from dataclasses import dataclass, field
from typing import Literal, NamedTuple

Mechanism = Literal["counts", "message", "command", "drive", "parameter", "body"]
"""counts, message, command: components in a wire. drive: one behind a drive. parameter: one that writes into another's
memory. body: done by the component of what the robot presses on."""

Detection = Literal["yes", "if large", "no"]

EVERY = 0.0
"""Said of a magnitude: every one of them, and kinds that have none."""


class Seen(NamedTuple):
    """What is said, before any run, of the safety monitor: from which magnitude on it sees a fault that stays.

    Attributes:
        free: if it begins in free motion.
        contact: if it begins in contact. None: not at any.
    """

    free: float | None = None
    contact: float | None = None


ALWAYS, NEVER = Seen(EVERY, EVERY), Seen()

POSITIVE = {"gt": 0.0}
SHARE = {"gt": 0.0, "le": 1.0}


@dataclass(frozen=True)
class Kind:
    """One kind of fault.

    Attributes:
        mechanism: how it is done.
        targets: what it can break; the first one is meant if none is named.
        meaning: what happens, one line.
        seen: from where on the safety monitor, which has the encoders' counts, the counter of their messages and the
            controller's command, is said to see it.
        reason: by what it sees it, or why it cannot.
        unit: of the magnitude as its TOML key writes it ("share" and "factor": pure numbers), if there is a magnitude.
        magnitudes: small, medium and large, in that unit, for matrices of faults.
        beyond: from which of them on the force is said to go beyond what the monitor is to keep it below; None: at
            none.
        bounds: of the magnitude, in that unit, as pydantic names them.
        has_share: whether a second number, `share`, says how many samples it hits.
    """

    mechanism: Mechanism
    targets: tuple[str, ...]
    meaning: str
    seen: Seen
    reason: str
    unit: str | None = None
    magnitudes: tuple[float, float, float] | None = None
    bounds: Mapping[str, float] = field(default_factory=dict)
    has_share: bool = False
    beyond: float | None = None

    @property
    def detection(self) -> Detection:
        """Whether it is said to be seen: always, at some magnitudes or in some places, or never."""
        return "yes" if self.seen == ALWAYS else "no" if self.seen == NEVER else "if large"

    def is_said_to_be_seen(self, magnitude: float | None, in_contact: bool) -> bool:
        """Whether a fault of one of `magnitudes` is."""
        return self._reached(magnitude, self.seen.contact if in_contact else self.seen.free)

    def is_said_to_go_beyond(self, magnitude: float | None) -> bool:
        """Whether the force may, with a fault of one of `magnitudes`."""
        return self._reached(magnitude, self.beyond)

    def _reached(self, magnitude: float | None, start: float | None) -> bool:
        if start is None or start == EVERY or self.magnitudes is None or magnitude is None:
            return start is not None
        # some kinds are larger the smaller their number is
        return self.magnitudes.index(magnitude) >= self.magnitudes.index(start)

    @property
    def magnitude_key(self) -> str | None:
        """The TOML key of the magnitude."""
        return f"magnitude_{self.unit}" if self.unit else None
