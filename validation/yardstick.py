"""One way to say what somebody else made, how far from it the twin may be, and how far it is."""

from collections.abc import Callable, Mapping
from dataclasses import dataclass, field
from importlib.metadata import PackageNotFoundError, version
from math import inf, isnan
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


STATED = ("claim", "source", "unit", "bound", "reason")
"""What a yardstick says before it is run."""


@dataclass(frozen=True)
class Finding:
    """What came of a yardstick.

    Attributes:
        name: of its file.
        yardstick: it.
        difference: the largest one; None if there is none.
        quantity: that differs most.
        remark: why there is no difference to tell.
        ran: whether it was run; one that was and has no difference failed.
        versions: of the packages it used.
    """

    name: str
    yardstick: Yardstick
    difference: float | None = None
    quantity: str = ""
    remark: str = ""
    ran: bool = True
    versions: Mapping[str, str] = field(default_factory=dict)

    @property
    def verdict(self) -> str:
        """holds, EXCEEDED, FAILED or not run."""
        if not self.ran:
            return "not run"
        if self.difference is None:
            return "FAILED"
        # nan is no difference that holds
        return "holds" if self.difference <= self.yardstick.bound else "EXCEEDED"

    @property
    def facts(self) -> dict[str, Any]:
        """For JSON."""
        stated = {key: getattr(self.yardstick, key) for key in STATED}
        come = {key: getattr(self, key) for key in ("difference", "quantity", "remark", "versions", "verdict")}
        return {"name": self.name, **stated, **come}


def found(name: str, yardstick: Yardstick) -> Finding:
    """Run a yardstick.

    Args:
        name: of its file.
        yardstick: one of those in it.
    """
    try:
        versions = {package: version(package) for package in yardstick.packages}
    except PackageNotFoundError as missing:
        lacks = f"{missing.name} is not installed: make validation installs it"
        return Finding(name, yardstick, ran=False, remark=lacks)
    try:
        differences = yardstick.differences()
    except NotHere as missing:
        return Finding(name, yardstick, ran=False, remark=str(missing))
    except Exception as failure:
        # a foreign library: whatever it was, the other yardsticks go on, and this one has not passed
        return Finding(name, yardstick, remark=f"{type(failure).__name__}: {failure}", versions=versions)
    if not differences:
        return Finding(name, yardstick, remark="nothing was compared", versions=versions)
    # max() alone would pass over nan
    quantity = max(differences, key=lambda key: inf if isnan(differences[key]) else differences[key])
    return Finding(name, yardstick, differences[quantity], quantity, versions=versions)
