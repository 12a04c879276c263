"""`twin cosim`: systems of third-party FMUs (SSP), without a robot."""

import math
from collections.abc import Sequence
from dataclasses import replace
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

from twin.kernel.errors import InputRefused
from twin.studies.command import Argument, ArgumentValues, Compile, Option, options_of, study
from twin.studies.result import Result
from twin.studies.systems.options import AdditionOptions, MasterOptions, SystemForm

if TYPE_CHECKING:
    from twin.kernel.process.reporter import Reporter


def _check_options(asked: ArgumentValues) -> None:
    for option in ("tick_ms", "stop_s", "state_every_s"):
        value = asked[option]
        if value is not None and not 0.0 < value < math.inf:
            raise InputRefused(f"--{option.replace('_', '-')} {value:g}: expected a number > 0")
    options_of(MasterOptions, asked).choice()
    for option, value in (("--from", asked["start_from"]), ("--state-every-s", asked["state_every_s"])):
        if asked["to"] is not None and value is not None:
            raise InputRefused(f"--to runs nothing, and does not go with {option}; leave one of them out")


@study(isolated=True, limited=True, before=[_check_options])
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
    added: AdditionOptions,
    master: MasterOptions,
    state_every_s: Annotated[float | None, Option("Save the state as often as this, for --from.", "S")] = None,
    start_from: Annotated[
        str | None,
        Option("Continue from a saved state of a run with the same options.", "RUN[@SECONDS]", "--from"),
    ] = None,
    out: Annotated[
        Path | None, Option("Folder of the run; default: results/cosim/SYSTEM/TIME. With --to: the file.", "DIR")
    ] = None,
    compiled: Compile = False,
    to: Annotated[SystemForm | None, Option("Run nothing, and write the system as SSP 1.0 to --out FILE.")] = None,
) -> Result:
    """Run one FMU, or a system of FMUs (SSP), and record the outputs of each.

    Several FMUs are written as a system, NAME_NAME.ssp, with wires guessed from
    names and units, and that system is run.

    Exit code: 0 done, 2 input refused, 3 a component failed while running
    (error, crash, hang), 130 interrupted, 143 terminated.

    Example: twin cosim system.ssp --input 'shaft.omega_ref=step(0.05)'
    """
    from twin.studies.result import Note
    from twin.studies.systems.recorded import record_system, write_joined_system, write_system

    choice, additions = master.choice(), added.additions()
    (whole, *others), wires = system, list[Note]()
    if others:
        whole, wires = write_joined_system(system, choice, out if to is not None else None, compiled)
        if to is not None:
            return Result(f"{whole.stem} written as SSP 1.0", wires, {"ssp": str(whole)}, {"ssp": str(whole)})
    if to is not None:
        return write_system(whole, choice, out, compiled, additions)
    done = record_system(reporter, whole, choice, out, compiled, state_every_s, start_from, additions)
    return replace(done, body=[*wires, *done.body], files={"system": whole, **done.files}) if others else done
