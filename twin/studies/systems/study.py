"""`twin cosim`: SSP systems of third-party FMUs, without a robot."""

import math
from collections.abc import Sequence
from dataclasses import replace
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


class SystemForm(StrEnum):
    """What a system can be written as."""

    SSP = "ssp"


class FmuKindSolver(StrEnum):
    """What solves the equations of FMUs for model exchange."""

    CVODE = "cvode"
    RK4 = "rk4"


class LoopCoupling(StrEnum):
    """What is done about algebraic loops."""

    DELAY = "delay"
    SOLVE = "solve"


def _check_master(asked: Asked) -> None:
    from twin.kernel.systems.choice import chosen

    chosen(asked)


def _check_times(asked: Asked) -> None:
    for option in ("tick_ms", "stop_s", "state_every_s"):
        value = asked[option]
        if value is not None and not 0.0 < value < math.inf:
            raise InputRefused(f"--{option.replace('_', '-')} {value:g}: expected a number > 0")


def _check_writing(asked: Asked) -> None:
    for option, value in (("--from", asked["start_from"]), ("--state-every-s", asked["state_every_s"])):
        if asked["to"] is not None and value is not None:
            raise InputRefused(f"--to runs nothing, and does not go with {option}; leave one of them out")


@study(isolated=True, limited=True, before=[_check_times, _check_master, _check_writing])
def cosim(
    system: Annotated[
        Sequence[Path],
        Argument(
            "An SSP archive (1.0, 2.0), an FMU, an OspSystemStructure.xml, or a multi-model (JSON). Several FMUs are "
            "joined by guessed wires.",
            "SYSTEM",
        ),
    ],
    reporter: "Reporter",
    settings: Annotated[
        Sequence[str],
        Option(
            "Value of a parameter or input, such as Gain1.k=2, s.v=60[rpm]; may be repeated.", "NAME=VALUE", "--set"
        ),
    ] = (),
    parameters: Annotated[
        Sequence[Path], Option("Values of an SSV file; --set wins over them. May be repeated.", "FILE.ssv", "--ssv")
    ] = (),
    inputs: Annotated[
        Sequence[str],
        Option(
            "Input over time: u=step(1.0), u=file.csv:COLUMN[UNIT], u=run.mcap:SIGNAL, or a CSV file whose columns "
            "are called as inputs are; may be repeated.",
            "NAME=SOURCE",
            "--input",
        ),
    ] = (),
    records: Annotated[
        Sequence[str],
        Option(
            "Record these variables, also inputs, parameters and locals: '*.y'; may be repeated.", "PATTERN", "--record"
        ),
    ] = (),
    scheme: Annotated[
        CouplingScheme | None,
        Option("gauss_seidel: components one after the other, as in the file; jacobi: all at once."),
    ] = None,
    tick_ms: Annotated[float | None, Option("Communication step; default: the system's own.", "MS")] = None,
    stop_s: Annotated[float | None, Option("Stop time; default: that of the system's default experiment.", "S")] = None,
    start_s: Annotated[float | None, Option("Start time; default: that of the default experiment.", "S")] = None,
    kind: Annotated[
        Sequence[str],
        Option("Use FMUs that are both as co_simulation or model_exchange; may be repeated.", "[COMPONENT=]KIND"),
    ] = (),
    solver: Annotated[
        FmuKindSolver | None,
        Option("Of FMUs for model exchange: cvode (default) holds a tolerance, rk4 goes one step per tick."),
    ] = None,
    loops: Annotated[
        LoopCoupling,
        Option("Algebraic loops: delay one value by a step, or solve them by Newton's method."),
    ] = LoopCoupling.DELAY,
    step: Annotated[
        Sequence[str], Option("Longer step of a component, whole ticks; may be repeated.", "COMPONENT=MS")
    ] = (),
    order: Annotated[str, Option("Components that step first; the others follow.", "A,B")] = "",
    lenient: Annotated[
        bool,
        Option(
            "Let through, and list: enumerations by number, units in brackets, missing functions, FMUs that need their "
            "tool; round a step that does not divide the run."
        ),
    ] = False,
    state_every_s: Annotated[float | None, Option("Save the state as often as this, for --from.", "S")] = None,
    start_from: Annotated[
        str | None,
        Option("Go on from a state of a run with the same options.", "RUN[@SECONDS]", "--from"),
    ] = None,
    out: Annotated[
        Path | None, Option("Folder of the run; default: results/cosim/SYSTEM/TIME. With --to: the file.", "DIR")
    ] = None,
    compiled: Compile = False,
    to: Annotated[SystemForm | None, Option("Run nothing, and write the system as SSP 1.0 to --out FILE.")] = None,
) -> Result:
    """Run one FMU, or a system of FMUs (SSP), and record the outputs of each.

    Of several FMUs it writes a system, NAME_NAME.ssp, with wires guessed from
    names and units, and runs that.

    Exit code: 0 done, 2 input refused, 3 a component failed while running
    (error, crash, hang), 130 interrupted, 143 terminated.

    Example: twin cosim system.ssp --input 'shaft.omega_ref=step(0.05)'

    Raises:
        InputRefused, ComponentFailed, NotWritten: see `recorded_system`.
    """
    from twin.kernel.systems.additions import Additions
    from twin.kernel.systems.choice import chosen
    from twin.studies.result import Note
    from twin.studies.systems.recorded import joined_system, recorded_system, written_system

    choice, added = chosen(locals()), Additions(settings, parameters, inputs, records)
    (whole, *others), wires = system, list[Note]()
    if others:
        whole, wires = joined_system(system, choice, out if to is not None else None, compiled)
        if to is not None:
            return Result(f"{whole.stem} written as SSP 1.0", wires, {"ssp": str(whole)}, {"ssp": str(whole)})
    if to is not None:
        return written_system(whole, choice, out, compiled, added)
    done = recorded_system(reporter, whole, choice, out, compiled, state_every_s, start_from, added)
    return replace(done, body=[*wires, *done.body], files={"system": whole, **done.files}) if others else done
