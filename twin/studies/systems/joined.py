"""Several FMUs joined into one system: wires guessed from names and units, written as an SSP archive."""

from collections import Counter
from collections.abc import Sequence
from pathlib import Path

from twin.kernel.errors import InputRefused
from twin.kernel.fmi.description import described
from twin.kernel.ssp.package import Package, loose_package
from twin.kernel.ssp.structure import Connection, Endpoint, SspComponent, SspSystem, Structure
from twin.kernel.systems.naming import identifier, unique_names
from twin.robot.drive.mapping import WireProposal, part_name, propose_wires, wire_error

FMUS_FORM = "FMUs"


def join_fmus(fmus: Sequence[Path], lenient: bool = False) -> tuple[Package, list[WireProposal]]:
    """Join several FMUs into a system by guessed wires; return it with the doubtful wires left out.

    An input is wired to the output of the same name in another FMU; else to the only output of the same dimension that
    feeds nothing else; else to the only output of the preceding FMUs that can feed it.
    """
    for fmu in fmus:
        if fmu.suffix.lower() != ".fmu":
            raise InputRefused(f"{fmu}: several files must all be FMUs; give one system, or FMUs")
    names = unique_names(identifier(fmu.stem) for fmu in fmus)
    variables = {
        f"{name}.{v.name}": v
        for name, fmu in zip(names, fmus, strict=True)
        for v in described(fmu, lenient=lenient).variables.values()
    }
    found = propose_wires(variables)
    targets, sources = Counter(one.target for one in found), Counter(one.source for one in found)
    sure = [one for one in found if one.sure or (targets[one.target] == 1 and sources[one.source] == 1)]
    for target in [n for n, v in variables.items() if v.causality == "input" and n not in targets]:
        before = names[: names.index(part_name(target))]
        able = [n for n, v in variables.items() if v.causality == "output" and part_name(n) in before
                and not wire_error(variables, n, target) and v.size == variables[target].size]  # fmt: skip
        sure += [WireProposal(able[0], target)] if len(able) == 1 and able[0] not in sources else []
    if not sure:
        inputs = ", ".join(name for name, v in variables.items() if v.causality == "input") or "none"
        listed = " and ".join(fmu.name for fmu in fmus)
        raise InputRefused(
            f"{listed}: no output has the name of another FMU's input, or is the only one that can feed it (inputs: "
            f"{inputs}); write the wires into an OspSystemStructure.xml or an SSP"
        )
    parts = tuple(SspComponent(name, f"{name}.fmu") for name in names)
    ends = [(one.source.split(".", 1), one.target.split(".", 1)) for one in sure]
    wires = tuple(Connection(Endpoint(*source), Endpoint(*target)) for source, target in ends)
    whole = "_".join(names)
    structure = Structure(whole, SspSystem(whole, parts, wires))
    files = {f"{name}.fmu": fmu for name, fmu in zip(names, fmus, strict=True)}
    return loose_package(Path(f"{whole}.ssp"), structure, files, FMUS_FORM), [one for one in found if one not in sure]
