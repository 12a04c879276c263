"""How long a system is run, and in which steps."""

import math
from collections.abc import Mapping
from typing import NamedTuple

from twin.cosim.ssp.package import Package
from twin.drive.description import FmuDescription, stated_step
from twin.drive.variable import number
from twin.errors import InputRefused
from twin.files import xml_of

MOST_TICKS = 1e12
STEPS = ("stepSize", "baseStepSize")
"""What OMSimulator and libcosim call the length of a step in annotations."""


class Timing(NamedTuple):
    """Length of a step (s), who says so, and how many there are."""

    tick: float
    source: str
    ticks: int


def timing(
    package: Package, descriptions: Mapping[str, FmuDescription], tick: float | None, stop: float | None
) -> Timing:
    """As the system of an archive says.

    Args:
        package: of the system.
        descriptions: of the FMUs, by component.
        tick: length of a step (s) that somebody wants; None: nobody.
        stop: end of the run (s), likewise.

    Raises:
        InputRefused: nobody says it, the run would not begin at 0, or not end with a step.
    """
    length, source = (tick, "--tick-ms") if tick is not None else _stated(package, descriptions)
    experiment = package.structure.experiment
    end = experiment.stop if stop is None else stop
    if experiment.start:
        raise InputRefused(f"{package.file}: its experiment starts at {experiment.start:g} s; here runs begin at 0 s")
    if end is None:
        raise InputRefused(f"{package.file}: says nothing of how long to run (DefaultExperiment); say --stop-s")
    if not 0.0 < end / length < MOST_TICKS:
        raise InputRefused(
            f"{package.file}: {end:g} s in steps of {length:g} s; expected at least one step, and fewer than "
            f"{MOST_TICKS:g}"
        )
    ticks = round(end / length)
    if ticks < 1 or abs(ticks * length - end) > 1e-6 * length:
        raise InputRefused(
            f"{package.file}: {end:g} s are no whole number of steps of {1e3 * length:g} ms; choose --stop-s, --tick-ms"
        )
    return Timing(length, source, ticks)


def _stated(package: Package, descriptions: Mapping[str, FmuDescription]) -> tuple[float, str]:
    """The length of a step (s), and who says so: a tool in the structure, else the FMU that wants the shortest."""
    structure = package.structure
    for note in (*structure.experiment.annotations, *structure.system.annotations, *structure.annotations):
        where = f"{package.file}: annotation {note.type}"
        for element in xml_of(note.content.encode(), where).iter() if note.content else ():
            for name in STEPS:
                if 0.0 < (step := number(element.get(name))) < math.inf:
                    return step, f"an annotation of the structure ({note.type})"
    steps = {path: step for path, one in descriptions.items() if 0.0 < (step := stated_step(one)) < math.inf}
    if not steps:
        raise InputRefused(f"{package.file}: neither the structure nor an FMU says how long a step is; say --tick-ms")
    shortest = min(steps, key=lambda path: steps[path])
    return steps[shortest], f"what the FMU of {shortest} wants{'' if len(steps) == 1 else ', the shortest'}"
