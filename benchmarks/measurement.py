"""One measured figure, and how subjects are measured side by side."""

from collections.abc import Callable, Mapping
from dataclasses import dataclass
from statistics import median


@dataclass(frozen=True)
class Measurement:
    """One line of the table.

    Attributes:
        name: what was measured.
        value: in `unit`; None if it could not be measured, `remark` says why.
        at_most, at_least: the target; neither: for information.
    """

    name: str
    value: float | None
    unit: str
    at_most: float | None = None
    at_least: float | None = None
    remark: str = ""

    @property
    def verdict(self) -> str:
        """ok, MISSED, not measured, or nothing where there is no target."""
        if self.value is None:
            return "not measured"
        if self.at_most is None and self.at_least is None:
            return ""
        low = self.at_least is None or self.value >= self.at_least
        high = self.at_most is None or self.value <= self.at_most
        return "ok" if low and high else "MISSED"


class Rounds:
    """Times of several subjects, taken in turns so that a busy machine slows all of them alike.

    Args:
        subjects: functions that do the work once and return the seconds it took.
        count: number of rounds; in each, every subject has one turn.
    """

    def __init__(self, subjects: Mapping[str, Callable[[], float]], count: int):
        self.seconds: dict[str, list[float]] = {name: [] for name in subjects}
        for _ in range(count):
            for name, subject in subjects.items():
                self.seconds[name].append(subject())

    def typical(self, name: str) -> float:
        """Median time of a subject (s)."""
        return median(self.seconds[name])

    def ratio(self, numerator: str, denominator: str) -> float:
        """Median over the rounds of the ratio within a round: what slowed both cancels."""
        pairs = zip(self.seconds[numerator], self.seconds[denominator], strict=True)
        return median(a / b for a, b in pairs)
