"""What gains are to achieve, at every corner."""

import math
from dataclasses import dataclass

from twin.errors import InputRefused


@dataclass(frozen=True)
class Goals:
    """Goals, SI; each holds at the worst corner.

    Attributes:
        sensitivity: largest M_s of any loop, > 1. It guarantees a gain margin of M_s / (M_s - 1) and a phase margin of
            2 asin(1 / (2 M_s)) (Astrom and Hagglund 2006, Advanced PID Control, Sec. 4.6).
        overshoot: largest overshoot of a step (share of it).
        bandwidth: least bandwidth (rad/s) of the law `law`; None: none is asked.
        law: "force", or "position" where no force loop acts.

    Raises:
        InputRefused: no gains can ever meet them.
    """

    sensitivity: float = 1.6
    overshoot: float = 0.05
    bandwidth: float | None = None
    law: str = "force"

    def __post_init__(self) -> None:
        if not (math.isfinite(self.sensitivity) and self.sensitivity > 1.0):
            raise InputRefused(
                f"--margin {self.sensitivity:g}: no loop keeps its largest |1/(1+L)| that small; expected more than 1, "
                "as a rule 1.3 to 2"
            )
        if not 0.0 <= self.overshoot <= 1.0:
            raise InputRefused(f"--overshoot-percent {100 * self.overshoot:g}: expected 0 to 100")
        if self.bandwidth is not None and not (math.isfinite(self.bandwidth) and self.bandwidth > 0.0):
            raise InputRefused(f"--bandwidth-Hz {self.bandwidth_hertz:g}: expected more than 0")

    @property
    def bandwidth_hertz(self) -> float:
        """For people; 0 if none is asked."""
        return (self.bandwidth or 0.0) / (2.0 * math.pi)

    def refuse_period(self, period: float) -> None:
        """Refuse a bandwidth that a controller with `period` (s) cannot have.

        Raises:
            InputRefused: it is beyond half the rate of the controller.
        """
        if self.bandwidth is not None and self.bandwidth >= math.pi / period:
            raise InputRefused(
                f"--bandwidth-Hz {self.bandwidth_hertz:g}: beyond half the controller's rate of "
                f"{1.0 / period:g} Hz; ask for less, or lower [controller] period_ms"
            )


def stiffness_range(text: str) -> tuple[float, float]:
    """(lowest, highest) stiffness (N/m) of `text`, "300:5000".

    Raises:
        InputRefused: it is not an ascending range of positive numbers.
    """
    try:
        low, high = (float(number) for number in text.split(":"))
    except ValueError:
        low, high = 0.0, 0.0
    if not (math.isfinite(high) and 0.0 < low <= high):
        raise InputRefused(
            f"--stiffness-N-per-m {text}: expected two numbers above 0, the lower first, for example 300:5000"
        )
    return low, high
