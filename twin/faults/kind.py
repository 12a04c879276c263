"""What is known of a kind of fault before any of them happens."""

from collections.abc import Mapping
from dataclasses import dataclass, field
from typing import Literal

Mechanism = Literal["counts", "message", "command", "drive", "parameter", "body"]
"""counts, message, command: components in a wire. drive: one behind a drive. parameter: one that writes into another's
memory. body: done by the component of what the robot presses on."""

Detection = Literal["yes", "if large", "no"]

POSITIVE = {"gt": 0.0}
SHARE = {"gt": 0.0, "le": 1.0}


@dataclass(frozen=True)
class Kind:
    """One kind of fault.

    Attributes:
        mechanism: how it is done.
        targets: what it can break; the first one is meant if none is named.
        meaning: what happens, one line.
        detection: whether the safety monitor, which has the encoders' counts, the counter of their messages and the
            controller's command, can see it.
        reason: by what it sees it, or why it cannot.
        unit: of the magnitude as its TOML key writes it ("share" and "factor": pure numbers), if there is a magnitude.
        magnitudes: small, medium and large, in that unit, for matrices of faults.
        bounds: of the magnitude, in that unit, as pydantic names them.
        has_share: whether a second number, `share`, says how many samples it hits.
    """

    mechanism: Mechanism
    targets: tuple[str, ...]
    meaning: str
    detection: Detection
    reason: str
    unit: str | None = None
    magnitudes: tuple[float, float, float] | None = None
    bounds: Mapping[str, float] = field(default_factory=dict)
    has_share: bool = False

    @property
    def magnitude_key(self) -> str | None:
        """The TOML key of the magnitude."""
        return f"magnitude_{self.unit}" if self.unit else None
