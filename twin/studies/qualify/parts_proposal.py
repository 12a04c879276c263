"""A mapping.toml to start from for a drive of several FMUs: parts, wires, roles."""

import os
import re
from collections.abc import Iterable, Mapping, Sequence
from pathlib import Path
from typing import NamedTuple

from twin.drive.contract import COMMANDS
from twin.drive.description import FmuDescription
from twin.drive.mapping import Join, joins, objection
from twin.drive.variable import Variable
from twin.errors import visible
from twin.runs.assembly.drives import qualified
from twin.studies.qualify.proposal import LOOP, quoted, roles_text, understood

MOST = 20
"""Inputs listed that nobody feeds."""


class KnownWire(NamedTuple):
    """What leads from an output to an input, "part.variable" each, and why twin cannot do as it says; "" if it can."""

    source: str
    target: str
    objection: str = ""


def part_names(files: Iterable[Path]) -> list[str]:
    """A name for each of several FMUs, as tables are called: its file's, with a number if another has that."""
    names: list[str] = []
    for file in files:
        name = re.sub(r"\W+", "_", file.stem, flags=re.ASCII).strip("_") or "part"
        names.append(next(n for k in range(len(names) + 1) if (n := f"{name}_{k + 1}" if k else name) not in names))
    return names


def parts_proposal(
    parts: Mapping[str, FmuDescription], folder: Path, connections: Sequence[KnownWire] | None = None
) -> tuple[str, bool]:
    """(text of a mapping.toml for `folder`, whether it is complete as it is).

    Args:
        parts: FMUs by part.
        folder: where the file will stand.
        connections: what leads where, of whoever knows it; None: proposed.
    """
    variables = {qualified(part, v.name): v for part, fmu in parts.items() for v in fmu.variables.values()}
    wires = _proposed(joins(variables)) if connections is None else _given(variables, connections)
    wired = [target for target, _, remark in wires if not remark]
    free = {name: v for name, v in variables.items() if name not in wired}
    label = " + ".join(fmu.path.name for fmu in parts.values())
    command, found, sure = understood(label, free)
    doubt = "" if sure else "   # or one of: " + ", ".join(f'"{other}"' for other in COMMANDS if other != command)
    lines = [
        f"# How {visible(label)} make one drive, in their own names and units.",
        f'command = "{command}"{doubt}',
        "sign = 1                  # -1 if it turns the other way: twin drive check tells",
        "gear_ratio = 1.0          # turns of its shaft per turn of the robot's motor shaft",
    ]
    for part, fmu in parts.items():
        lines += ["", f"[parts.{part}]", f"fmu = {quoted(_seen_from(folder, fmu.path))}", f'sha256 = "{fmu.sha256}"']
    lines += ["", "[wires]                   # input = output"]
    lines += [_wire_line(variables, *wire) for wire in wires]
    lines.append(roles_text(free, found, command))
    roles = set(found.chosen.values())
    unfed = [name for name, v in free.items() if v.causality == "input" and v.kind >= 0 and name not in roles]
    lines += _unfed_lines(free, unfed)
    if command != "velocity":
        lines.append(LOOP.format(unit=COMMANDS[command].port.unit))
    doubtful = any(remark for _, _, remark in wires)
    return "\n".join(lines).rstrip("\n") + "\n", sure and command == "velocity" and not doubtful


def _proposed(found: Sequence[Join]) -> list[tuple[str, str, str]]:
    return [(join.target, join.source, "" if join.sure else "perhaps") for join in found]


def _given(variables: Mapping[str, Variable], connections: Sequence[KnownWire]) -> list[tuple[str, str, str]]:
    """(input, output, why it is left out) of each connection."""
    wires: list[tuple[str, str, str]] = []
    for source, target, remark in connections:
        remark = remark or objection(variables, source, target)
        if not remark and target in [wired for wired, _, doubt in wires if not doubt]:
            remark = "it is wired already"
        wires.append((target, source, remark))
    return wires


def _wire_line(variables: Mapping[str, Variable], target: str, source: str, remark: str) -> str:
    units = " <- ".join(
        f"[{variables[end].unit or 'no unit'}]" if end in variables else "?" for end in (target, source)
    )
    comment = visible(f"{units}{', ' if remark else ''}{remark}")
    return f"{'# ' if remark else ''}{quoted(target)} = {quoted(source)}   # {comment}"


def _unfed_lines(variables: Mapping[str, Variable], unfed: Sequence[str]) -> list[str]:
    """Comments on inputs that nobody feeds."""
    if not unfed:
        return []
    lines = ["# Not fed, so they keep their start values, or what [parts.NAME.parameters] says:"]
    lines += [visible(f"#   {name} = {variables[name].start:g}") for name in unfed[:MOST]]
    return lines + ([f"#   and {len(unfed) - MOST} more"] if len(unfed) > MOST else [])


def _seen_from(folder: Path, file: Path) -> str:
    return Path(os.path.relpath(file.absolute(), folder.absolute())).as_posix()
