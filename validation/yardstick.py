"""One way to say what somebody else made, how far from it the twin may be, and how far it is."""

from collections.abc import Callable, Mapping
from dataclasses import asdict, dataclass
from importlib.metadata import PackageNotFoundError, version
from typing import Any


class NotHere(Exception):
    """What a yardstick needs is not installed; its text says what that is."""


@dataclass(frozen=True)
class Yardstick:
    """A comparison with what others made.

    Attributes:
        claim: what is compared with what.
        source: who made the yardstick.
        unit: of the differences.
        bound: the largest difference that is allowed.
        reason: why that bound, and where the difference comes from.
        differences: works them out, by the name of what differs; may raise `NotHere`.
        packages: distributions that it needs; their versions are noted.
    """

    claim: str
    source: str
    unit: str
    bound: float
    reason: str
    differences: Callable[[], Mapping[str, float]]
    packages: tuple[str, ...] = ()


@dataclass(frozen=True)
class Finding:
    """What came of a yardstick.

    Attributes:
        name: of its file.
        claim: as in `Yardstick`, like source, unit, bound and reason.
        source: see there.
        unit: see there.
        bound: see there.
        reason: see there.
        difference: the largest one; None if there is none.
        quantity: that differs most.
        remark: why there is no difference to tell.
        ran: whether it was run; one that ended without a difference was, and failed.
        versions: of the packages it used.
    """

    name: str
    claim: str
    source: str
    unit: str
    bound: float
    reason: str
    difference: float | None = None
    quantity: str = ""
    remark: str = ""
    ran: bool = True
    versions: Mapping[str, str] | None = None

    @property
    def verdict(self) -> str:
        """holds, EXCEEDED, FAILED or not run."""
        if not self.ran:
            return "not run"
        if self.difference is None:
            return "FAILED"
        # nan is no difference that holds
        return "holds" if self.difference <= self.bound else "EXCEEDED"

    @property
    def facts(self) -> dict[str, Any]:
        """For JSON."""
        return asdict(self) | {"verdict": self.verdict}


def found(name: str, yardstick: Yardstick) -> Finding:
    """Run a yardstick.

    Args:
        name: of its file.
        yardstick: one of those in it.
    """
    facts: dict[str, Any] = {key: getattr(yardstick, key) for key in ("claim", "source", "unit", "bound", "reason")}
    try:
        versions = {package: version(package) for package in yardstick.packages}
    except PackageNotFoundError as missing:
        return Finding(name, **facts, ran=False, remark=f"{missing.name} is not installed: make validation installs it")
    try:
        differences = yardstick.differences()
    except NotHere as missing:
        return Finding(name, **facts, ran=False, remark=str(missing))
    except Exception as failure:
        # a foreign library: whatever it was, the other yardsticks go on, and this one has not passed
        return Finding(name, **facts, remark=f"{type(failure).__name__}: {failure}", versions=versions)
    # max() may pass over nan
    quantity = next((key for key in differences if differences[key] != differences[key]), "") or max(
        differences, key=lambda key: differences[key], default=""
    )
    if not quantity:
        return Finding(name, **facts, remark="nothing was compared", versions=versions)
    return Finding(name, **facts, difference=differences[quantity], quantity=quantity, versions=versions)
