"""The options of `twin cosim` as dataclasses, and their conversion for the kernel."""

import math
from collections.abc import Iterable, Sequence
from dataclasses import dataclass
from enum import StrEnum
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

from twin.kernel.errors import InputRefused, nearest
from twin.kernel.systems.choice import FMU_KINDS, MasterChoice
from twin.kernel.units import parse_float
from twin.studies.command import Option

if TYPE_CHECKING:
    from twin.kernel.fmi.description import Kind
    from twin.kernel.systems.additions import Additions


class CouplingScheme(StrEnum):
    """Order of the value exchange between the components of a system of FMUs."""

    GAUSS_SEIDEL = "gauss_seidel"
    JACOBI = "jacobi"


class SystemForm(StrEnum):
    """File format of a written system of FMUs."""

    SSP = "ssp"


class FmuKindSolver(StrEnum):
    """Solver of a system's FMUs for model exchange."""

    CVODE = "cvode"
    RK4 = "rk4"


class LoopCoupling(StrEnum):
    """Treatment of algebraic loops in a system of FMUs."""

    DELAY = "delay"
    SOLVE = "solve"


@dataclass(frozen=True)
class AdditionOptions:
    """Command-line options for values, inputs and recorded variables of a system of FMUs."""

    settings: Annotated[
        Sequence[str],
        Option(
            "Value of a parameter or input, such as Gain1.k=2, s.v=60[rpm]; may be repeated.", "NAME=VALUE", "--set"
        ),
    ] = ()
    parameters: Annotated[
        Sequence[Path], Option("Values of an SSV file; --set wins over them. May be repeated.", "FILE.ssv", "--ssv")
    ] = ()
    inputs: Annotated[
        Sequence[str],
        Option(
            "Input over time: u=step(1.0), u=file.csv:COLUMN[UNIT], u=run.mcap:SIGNAL, or a CSV file whose columns "
            "are called as inputs are; may be repeated.",
            "NAME=SOURCE",
            "--input",
        ),
    ] = ()
    records: Annotated[
        Sequence[str],
        Option(
            "Record these variables, also inputs, parameters and locals: '*.y'; may be repeated.", "PATTERN", "--record"
        ),
    ] = ()

    def additions(self) -> "Additions":
        # The import loads FMPy.
        from twin.kernel.systems.additions import Additions

        return Additions(self.settings, self.parameters, self.inputs, self.records)


@dataclass(frozen=True)
class MasterOptions:
    """Command-line options of the co-simulation master for a system of FMUs."""

    scheme: Annotated[
        CouplingScheme | None,
        Option("gauss_seidel: components one after the other, as in the file; jacobi: all at once."),
    ] = None
    tick_ms: Annotated[float | None, Option("Communication step; default: the system's own.", "MS")] = None
    stop_s: Annotated[float | None, Option("Stop time; default: that of the system's default experiment.", "S")] = None
    start_s: Annotated[float | None, Option("Start time; default: that of the default experiment.", "S")] = None
    kind: Annotated[
        Sequence[str],
        Option("Use FMUs that are both as co_simulation or model_exchange; may be repeated.", "[COMPONENT=]KIND"),
    ] = ()
    solver: Annotated[
        FmuKindSolver | None,
        Option("Of FMUs for model exchange: cvode (default) holds a tolerance, rk4 goes one step per tick."),
    ] = None
    loops: Annotated[
        LoopCoupling,
        Option("Algebraic loops: delay one value by a step, or solve them by Newton's method."),
    ] = LoopCoupling.DELAY
    step: Annotated[
        Sequence[str], Option("Longer step of a component, whole ticks; may be repeated.", "COMPONENT=MS")
    ] = ()
    order: Annotated[str, Option("Components that step first; the others follow.", "A,B")] = ""
    lenient: Annotated[
        bool,
        Option(
            "Let through, and list: enumerations by number, units in brackets, missing functions, FMUs that need their "
            "tool; round a step that does not divide the run."
        ),
    ] = False

    def choice(self) -> MasterChoice:
        if self.start_s is not None and not 0.0 <= self.start_s < math.inf:
            raise InputRefused(f"--start-s {self.start_s:g}: expected a number, 0 or more")
        return MasterChoice(
            tick=None if self.tick_ms is None else self.tick_ms / 1000.0,
            start=self.start_s,
            stop=self.stop_s,
            scheme=self.scheme.value if self.scheme else None,
            kinds=kinds(self.kind),
            solver=self.solver.value if self.solver else None,
            steps=steps(self.step),
            order=order(self.order),
            loops=self.loops.value,
            lenient=self.lenient,
        )


def kinds(texts: Sequence[str]) -> "dict[str, Kind]":
    """Parse the values of `--kind [NAME=]KIND` into name -> kind, with name "" for all."""
    found: dict[str, Kind] = {}
    known = {str(kind): kind for kind in FMU_KINDS}
    for text in texts:
        name, _, value = text.rpartition("=")
        if value not in known:
            raise InputRefused(f"--kind {text}: {nearest(value, known, 'expected {}')}")
        _refuse_repeat(found, name, "--kind")
        found[name] = known[value]
    return found


def steps(texts: Sequence[str]) -> dict[str, float]:
    """Parse the values of `--step NAME=MS` into name -> step (s)."""
    found: dict[str, float] = {}
    for text in texts:
        name, _, value = text.rpartition("=")
        milliseconds = parse_float(value) or 0.0
        if not name or not 0.0 < milliseconds < math.inf:
            raise InputRefused(f"--step {text}: expected COMPONENT=MS with a number above 0")
        _refuse_repeat(found, name, "--step")
        found[name] = milliseconds / 1000.0
    return found


def order(text: str) -> list[str]:
    """Parse the value of `--order A,B` into a list of names."""
    found: dict[str, None] = {}
    for name in (part.strip() for part in text.split(",") if text):
        if not name:
            raise InputRefused(f"--order {text}: expected names of components with commas between them")
        _refuse_repeat(found, name, "--order")
        found[name] = None
    return list(found)


def _refuse_repeat(found: Iterable[str], name: str, option: str) -> None:
    if name in found:
        raise InputRefused(f"{option}: '{name}' is given twice; expected it once" if name else f"{option} is given "
                           "twice without a component; expected it once")  # fmt: skip
