"""`twin cosim`: SSP systems of third-party FMUs, without a robot."""

import math
from collections.abc import Sequence
from enum import StrEnum
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

from twin.kernel.errors import InputRefused
from twin.studies.command import Argument, Asked, Compile, Option, study
from twin.studies.result import Result

if TYPE_CHECKING:
    from twin.kernel.process.reporter import Reporter


class CouplingScheme(StrEnum):
    """Who sees whose newest values."""

    GAUSS_SEIDEL = "gauss_seidel"
    JACOBI = "jacobi"


class FmuKindSolver(StrEnum):
    """What solves the equations of FMUs for model exchange."""

    CVODE = "cvode"
    RK4 = "rk4"


class LoopCoupling(StrEnum):
    """What is done about algebraic loops."""

    DELAY = "delay"
    SOLVE = "solve"


def _check_master(asked: Asked) -> None:
    from twin.studies.systems.choice import chosen

    chosen(asked)


def _check_times(asked: Asked) -> None:
    for option in ("tick_ms", "stop_s", "state_every_s"):
        value = asked[option]
        if value is not None and not 0.0 < value < math.inf:
            raise InputRefused(f"--{option.replace('_', '-')} {value:g}: expected a number > 0")


@study(isolated=True, limited=True, before=[_check_times, _check_master])
def cosim(
    system: Annotated[Path, Argument("An SSP archive, 1.0 or 2.0.", "SYSTEM.ssp")],
    reporter: "Reporter",
    scheme: Annotated[
        CouplingScheme,
        Option("gauss_seidel: components one after the other, as in the file; jacobi: all at once."),
    ] = CouplingScheme.GAUSS_SEIDEL,
    tick_ms: Annotated[float | None, Option("Communication step; default: the system's own.", "MS")] = None,
    stop_s: Annotated[float | None, Option("Stop time; default: that of the system's default experiment.", "S")] = None,
    start_s: Annotated[float | None, Option("Start time; default: that of the default experiment.", "S")] = None,
    kind: Annotated[
        Sequence[str],
        Option("Use FMUs that are both as co_simulation or model_exchange; may be repeated.", "[COMPONENT=]KIND"),
    ] = (),
    solver: Annotated[
        FmuKindSolver, Option("Of FMUs for model exchange: cvode holds a tolerance, rk4 goes one step per tick.")
    ] = FmuKindSolver.CVODE,
    loops: Annotated[
        LoopCoupling,
        Option("Algebraic loops: delay one value by a step, or solve them by Newton's method."),
    ] = LoopCoupling.DELAY,
    tolerance: Annotated[
        float | None, Option("Steps as long as this relative error allows, if all FMUs can go back.", "REL")
    ] = None,
    step: Annotated[
        Sequence[str], Option("Longer step of a component, whole ticks; may be repeated.", "COMPONENT=MS")
    ] = (),
    order: Annotated[str, Option("Components that step first; the others follow.", "A,B")] = "",
    lenient: Annotated[
        bool,
        Option("Let through, and list: enumerations by number, units in brackets, missing functions."),
    ] = False,
    state_every_s: Annotated[float | None, Option("Save the state as often as this, for --from.", "S")] = None,
    start_from: Annotated[
        str | None,
        Option("Go on from a state of a run with the same options.", "RUN[@SECONDS]", "--from"),
    ] = None,
    out: Annotated[Path | None, Option("Folder of the run; default: results/cosim/SYSTEM/TIME.", "DIR")] = None,
    compiled: Compile = False,
) -> Result:
    """Run a system of FMUs (SSP), and record the outputs of each.

    Exit code: 0 done, 2 input refused, 3 a component failed while running
    (error, crash, hang), 130 interrupted, 143 terminated.

    Example: twin cosim system.ssp --scheme jacobi --tick-ms 1

    Raises:
        InputRefused, ComponentFailed, NotWritten: see `recorded_system`.
    """
    from twin.studies.systems.choice import chosen
    from twin.studies.systems.recorded import recorded_system

    choice = chosen(locals())
    return recorded_system(reporter, system, choice, out, compiled, state_every_s, start_from)
