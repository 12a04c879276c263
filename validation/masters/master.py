"""The yardsticks that a program with a master of its own makes: whole runs, and why they differ."""

from collections.abc import Callable, Mapping
from dataclasses import dataclass
from functools import cache, partial

from validation.masters.plain_loop import looped
from validation.masters.robot import Case, Robot, Signals, differences, robot
from validation.yardstick import Yardstick

FIG4 = Case("fig4_force_position", 20.0)
MASSAGE = Case("massage", 62.0)
BIT_FOR_BIT = 0.0
SAME_BITS = "the same FMUs in the same steps with the same numbers on the wires give the same bits"
ROUNDING = 1e-11
WHY_ROUNDING = (
    "a last bit in the step of a drive or in an angle grows to some 1e-12 of the range of a speed; springs that are a "
    "billionth stiffer already come to 1e-9"
)


@dataclass(frozen=True)
class Master:
    """A program that runs systems of FMUs.

    Attributes:
        run: has it run a robot, all of its components exchanging their values between steps.
        source: who made it.
        packages: distributions that it comes in.
        starts_inside: its wires cannot add, so that the drives are given their start angles.
    """

    run: Callable[[Robot], Signals]
    source: str
    packages: tuple[str, ...] = ()
    starts_inside: bool = False


def beside_the_twin(master: Master, case: Case, bound: float, reason: str) -> Yardstick:
    """A run in another master beside the twin's own."""
    return Yardstick(
        f"{case}: every output of drives, plant and computer beside the twin's own run",
        master.source,
        "of the signal's range",
        bound,
        reason,
        partial(_beside_the_twin, master, case),
        master.packages,
    )


def beside_a_loop(master: Master, case: Case, time_of: Callable[[int], float], how: str) -> Yardstick:
    """The same beside a loop of some lines that counts time as the master does: whether that explains all.

    Args:
        master: whose differences are explained.
        case: what is run.
        time_of: of an instant between two steps (s).
        how: that is.
    """
    return Yardstick(
        f"{case}: the same outputs beside a plain loop that {how}, which is then all there is to it",
        master.source,
        "",
        BIT_FOR_BIT,
        SAME_BITS,
        partial(_beside_a_loop, master, case, time_of),
        master.packages,
    )


def _given(master: Master, case: Case) -> Robot:
    return robot(case).starting_inside() if master.starts_inside else robot(case)


@cache
def _traced(master: Master, case: Case) -> Signals:
    return master.run(_given(master, case))


def _beside_the_twin(master: Master, case: Case) -> Mapping[str, float]:
    return differences(_traced(master, case), robot(case).own)


def _beside_a_loop(master: Master, case: Case, time_of: Callable[[int], float]) -> Mapping[str, float]:
    theirs, again = _traced(master, case), looped(_given(master, case), time_of)
    return {key: float(abs(theirs[key][1:] - again[key][1:]).max()) for key in theirs}
