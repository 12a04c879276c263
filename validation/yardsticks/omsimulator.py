"""The robot in OMSimulator."""

from itertools import accumulate, repeat

from validation.masters.in_omsimulator import values
from validation.masters.master import FIG4, MASSAGE, Master, beside_a_loop, beside_the_twin
from validation.masters.robot import Robot, Rows, Signals
from validation.masters.wired import Wired


def run(given: Robot) -> Signals:
    """What OMSimulator gives.

    Raises:
        NotHere: its library is not here.
        RuntimeError: it refuses or fails.
    """
    outputs = [f"{name}.{output}" for name in given.files for output in given.outputs[name]]
    settings = {f"{part}.{name}": value for part, them in given.parameters.items() for name, value in them.items()}
    wires = tuple((".".join(wire.source), ".".join(wire.target)) for wire in given.wires)
    found = values(Wired(given.files, wires, tuple(outputs), given.own.tick, given.ticks, settings))
    rows, first = Rows(given), 0
    for name in given.files:
        until = first + len(given.outputs[name])
        rows.values[name][1:] = found[1:, first:until]
        first = until
    return rows.signals()


TIMES = tuple(accumulate(repeat(0.001, 62_000), initial=0.0))
"""As OMSimulator has them: one step after another added up (s)."""
OMSIMULATOR = Master(
    run, "OMSimulator 3.0, Open Source Modelica Consortium, built from its sources", starts_inside=True
)
SUMS = (
    "OMSimulator adds up time and hands on the difference of two sums, which after 20 s is off by 1e-12 of a step; its "
    "wires add nothing, so that the drives count from the angles where they begin"
)
SUMMED = 1e-10
WHY_SUMMED = "for long in the same direction, so that it comes to more"
YARDSTICKS = (
    beside_the_twin(OMSIMULATOR, FIG4, SUMMED, f"{SUMS}; {WHY_SUMMED}"),
    beside_a_loop(OMSIMULATOR, FIG4, TIMES.__getitem__, "adds up time"),
    beside_the_twin(OMSIMULATOR, MASSAGE, SUMMED, f"{SUMS}; {WHY_SUMMED}"),
    beside_a_loop(OMSIMULATOR, MASSAGE, TIMES.__getitem__, "adds up time"),
)
