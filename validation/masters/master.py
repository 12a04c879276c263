"""The yardsticks that a program with a master of its own makes: whole runs, and why they differ."""

from collections.abc import Callable, Mapping
from dataclasses import dataclass
from functools import cache, partial

from validation.masters.plain_loop import looped
from validation.masters.robot import Robot, Signals, differences, robot
from validation.yardstick import Yardstick

DURATIONS = {"fig4_force_position": 20.0}
"""Seconds of each experiment."""
EXPLAINED = "fig4_force_position"
BIT_FOR_BIT = 0.0
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
        starts_inside: its wires cannot add, so that the drives are told where they begin.
    """

    run: Callable[[Robot], Signals]
    source: str
    packages: tuple[str, ...] = ()
    starts_inside: bool = False


def beside_the_twin(master: Master, bound: float, reason: str) -> tuple[Yardstick, ...]:
    """Each experiment of `DURATIONS` beside the twin's own run."""
    return tuple(
        Yardstick(
            f"{duration:g} s of {experiment}: every output of drives, plant and computer beside the twin's own run",
            master.source,
            "of the signal's range",
            bound,
            reason,
            partial(_beside_the_twin, master, experiment),
            master.packages,
        )
        for experiment, duration in DURATIONS.items()
    )


def beside_a_loop(master: Master, time_of: Callable[[int], float], how: str) -> Yardstick:
    """An experiment beside a loop of some lines that counts time as the master does; else it could be anything.

    Args:
        master: whose differences are explained.
        time_of: of an instant between two steps (s).
        how: that is.
    """
    return Yardstick(
        f"{DURATIONS[EXPLAINED]:g} s of {EXPLAINED} beside a plain loop that {how}: there is no more to it",
        master.source,
        "",
        BIT_FOR_BIT,
        "the same FMUs in the same steps with the same numbers on the wires give the same bits",
        partial(_beside_a_loop, master, time_of),
        master.packages,
    )


def _given(master: Master, experiment: str) -> Robot:
    found = robot(experiment, DURATIONS[experiment])
    return found.starting_inside() if master.starts_inside else found


@cache
def _traced(master: Master, experiment: str) -> Signals:
    return master.run(_given(master, experiment))


def _beside_the_twin(master: Master, experiment: str) -> Mapping[str, float]:
    return differences(_traced(master, experiment), _given(master, experiment).own)


def _beside_a_loop(master: Master, time_of: Callable[[int], float]) -> Mapping[str, float]:
    theirs, again = _traced(master, EXPLAINED), looped(_given(master, EXPLAINED), time_of)
    return {key: float(abs(theirs[key][1:] - again[key][1:]).max()) for key in theirs}
