"""Proposal of a mapping.toml for third-party FMUs: complete if unambiguous, else with the doubtful lines commented.

A drive can be one FMU, several FMUs (parts, wires, roles), or a system in an SSP archive.
"""

import json
import os
import re
from collections.abc import Iterable, Mapping, Sequence
from contextlib import suppress
from pathlib import Path
from typing import NamedTuple

from twin.kernel.atomic_write import make_folder, write_bytes, write_text
from twin.kernel.errors import InputRefused, escape_controls
from twin.kernel.files import open_regular
from twin.kernel.fmi.description import FmuDescription, described
from twin.kernel.fmi.variable import Variable
from twin.kernel.ssp.package import Package, read_package
from twin.kernel.ssp.structure import IDENTITY_TRANSFORMATION, Connection, SspComponent
from twin.robot.assembly.drives import qualified_name
from twin.robot.drive.contract import COMMAND_ROLES, Command, Role, drive_roles
from twin.robot.drive.mapping import (
    RoleChoice,
    Wiring,
    bindings,
    candidates,
    choose_variables,
    likely_command,
    name_score,
    propose_wires,
    wire_error,
)
from twin.robot.experiment.drive_files import load_drive
from twin.robot.experiment.experiment_files import MAPPING_FILE
from twin.robot.paths import WHEEL_FOLDER

LOOP_TEMPLATE = """
[velocity_loop]           # twin's own, commands a drive that takes no speed; tune it, then remove the #
# kp = 0.1                # {unit} per rad/s
# ki = 1.0                # {unit} per rad
# limit = 1.0             # {unit}
# period_ms = 0.25
"""
MAX_UNFED_INPUTS = 20
MAX_PARTS = 50


def proposal(description: FmuDescription) -> tuple[str, bool]:
    """Return (text of a mapping.toml for an FMU as a drive, whether it is complete); it pins the FMU's hash."""
    command, found, sure = interpret_variables(description.path.name, description.variables)
    head = [
        "# How the drive contract's roles are filled by "
        f"{escape_controls(description.path.name)}, in its own names and units.",
        f"fmu = {toml_string(description.path.name)}",
        f'sha256 = "{description.sha256}"',
        *_command_lines(command, sure),
    ]
    text = "\n".join(head) + "\n" + roles_text(description.variables, found, command)
    if command not in ("velocity", "position"):
        text += LOOP_TEMPLATE.format(unit=COMMAND_ROLES[command].port.unit)
    return text, sure and command in ("velocity", "position")


def _command_lines(command: Command, sure: bool) -> list[str]:
    doubt = "" if sure else "   # or one of: " + ", ".join(f'"{other}"' for other in COMMAND_ROLES if other != command)
    return [
        f'command = "{command}"{doubt}',
        "sign = 1                  # -1 if it turns the other way: twin drive check shows it",
        "gear_ratio = 1.0          # turns of its shaft per turn of the robot's motor shaft",
    ]


def interpret_variables(file: str, variables: Mapping[str, Variable]) -> tuple[Command, RoleChoice, bool]:
    """Choose command and variables of an unmapped drive; `file`: its name in error messages."""
    fitting: list[Command] = []
    for command in COMMAND_ROLES:
        with suppress(InputRefused):
            bindings(file, variables, Wiring(command))
            found = _choice(file, variables, command)
            name = found.chosen[COMMAND_ROLES[command].port.name]
            # A lone torque next to a voltage may be another load.
            if name_score(name, variables[name], COMMAND_ROLES[command]) > 0:
                return command, found, True
            fitting.append(command)
    if fitting:
        return fitting[0], _choice(file, variables, fitting[0]), len(fitting) == 1
    command = likely_command(variables, _choice(file, variables, "velocity").chosen.values())
    return command, _choice(file, variables, command), False


def roles_text(variables: Mapping[str, Variable], found: RoleChoice, command: Command) -> str:
    return "".join(_table(variables, found, drive_roles(command), side) for side in ("input", "output"))


def _choice(file: str, variables: Mapping[str, Variable], command: Command) -> RoleChoice:
    return choose_variables(file, variables, Wiring(command), drive_roles(command))


def _table(variables: Mapping[str, Variable], found: RoleChoice, roles: Sequence[Role], side: str) -> str:
    lines = ["", f"[{side}s]"]
    for role in roles:
        if role.causality == side:
            name = found.chosen.get(role.port.name)
            lines += [_line(role, name, variables[name])] if name else _doubtful_lines(variables, found, role)
    return "\n".join(lines) + "\n"


def _doubtful_lines(variables: Mapping[str, Variable], found: RoleChoice, role: Role) -> list[str]:
    """Return a role's lines without a clear variable: the only candidate, several as comments, nothing if optional."""
    if not role.required:
        return []
    offered = candidates(variables, role, found.chosen.values())
    if not offered:
        return [f'# {role.port.name} = "?"   # {role.port.meaning}: no {role.causality} measures {role.port.unit}']
    return [("# " if len(offered) > 1 else "") + _line(role, name, variables[name]) for name in offered]


def _line(role: Role, name: str, variable: Variable) -> str:
    text = " ".join(filter(None, (f"[{variable.unit or 'no unit'}]", *variable.description.split())))
    return f"{role.port.name} = {toml_string(name)}   # {escape_controls(text)}"


def toml_string(name: str) -> str:
    return json.dumps(name, ensure_ascii=False)


class KnownWire(NamedTuple):
    """A connection of an output to an input, "part.variable" each, and the reason if twin does not support it."""

    source: str
    target: str
    objection: str = ""


def part_names(files: Iterable[Path]) -> list[str]:
    """Return a table name for each FMU of a drive: its file name, with a number if another has the same."""
    names: list[str] = []
    for file in files:
        name = re.sub(r"\W+", "_", file.stem, flags=re.ASCII).strip("_") or "part"
        names.append(next(n for k in range(len(names) + 1) if (n := f"{name}_{k + 1}" if k else name) not in names))
    return names


def parts_proposal(
    parts: Mapping[str, FmuDescription], folder: Path, connections: Sequence[KnownWire] | None = None
) -> tuple[str, bool]:
    """Return (mapping.toml for several FMUs, whether it is complete); `connections` None to propose them."""
    variables = {qualified_name(part, v.name): v for part, fmu in parts.items() for v in fmu.variables.values()}
    if connections is None:
        wires = [(join.target, join.source, "" if join.sure else "perhaps") for join in propose_wires(variables)]
    else:
        wires = _wire_remarks(variables, connections)
    wired = [target for target, _, remark in wires if not remark]
    free = {name: v for name, v in variables.items() if name not in wired}
    label = " + ".join(fmu.path.name for fmu in parts.values())
    command, found, sure = interpret_variables(label, free)
    lines = [
        f"# How {escape_controls(label)} make one drive, in their own names and units.",
        *_command_lines(command, sure),
    ]
    for part, fmu in parts.items():
        file = Path(os.path.relpath(fmu.path.absolute(), folder.absolute())).as_posix()
        lines += ["", f"[parts.{part}]", f"fmu = {toml_string(file)}", f'sha256 = "{fmu.sha256}"']
    lines += ["", "[wires]                   # input = output"]
    lines += [_wire_line(variables, *wire) for wire in wires]
    lines.append(roles_text(free, found, command))
    roles = set(found.chosen.values())
    unfed = [name for name, v in free.items() if v.causality == "input" and v.kind >= 0 and name not in roles]
    if unfed:
        lines.append("# Not connected, so they keep their start values, or those of [parts.NAME.parameters]:")
        lines += [escape_controls(f"#   {name} = {free[name].start:g}") for name in unfed[:MAX_UNFED_INPUTS]]
        lines += [f"#   and {len(unfed) - MAX_UNFED_INPUTS} more"] if len(unfed) > MAX_UNFED_INPUTS else []
    if command != "velocity":
        lines.append(LOOP_TEMPLATE.format(unit=COMMAND_ROLES[command].port.unit))
    doubtful = any(remark for _, _, remark in wires)
    return "\n".join(lines).rstrip("\n") + "\n", sure and command == "velocity" and not doubtful


def _wire_remarks(variables: Mapping[str, Variable], connections: Sequence[KnownWire]) -> list[tuple[str, str, str]]:
    """Return (input, output, reason why it is left out) of each connection of a drive of several FMUs."""
    wires: list[tuple[str, str, str]] = []
    for source, target, remark in connections:
        remark = remark or wire_error(variables, source, target)
        if not remark and target in [wired for wired, _, doubt in wires if not doubt]:
            remark = "it is wired already"
        wires.append((target, source, remark))
    return wires


def _wire_line(variables: Mapping[str, Variable], target: str, source: str, remark: str) -> str:
    units = " <- ".join(
        f"[{variables[end].unit or 'no unit'}]" if end in variables else "?" for end in (target, source)
    )
    comment = escape_controls(f"{units}{', ' if remark else ''}{remark}")
    return f"{'# ' if remark else ''}{toml_string(target)} = {toml_string(source)}   # {comment}"


def write_mapping(named: Sequence[str], start: Path) -> tuple[Path, bool]:
    """Write the mapping.toml of an FMU, of several that form one drive, or of the system in an SSP archive.

    Names are as `load_drive` accepts them, looked up from `start`. The mapping is written to the folder of the first
    FMU. FMUs of an SSP are extracted to a folder of its name next to the archive; a drive of the installed package is
    first copied to a folder of its name in the current folder. Return the file, and whether it is complete.
    """
    if any(name.endswith(".ssp") for name in named):
        if len(named) > 1:
            raise InputRefused(f"{' '.join(named)}: an SSP is a whole drive; name it alone")
        return _from_system(Path(named[0]))
    files = []
    for name in named:
        file = load_drive(name, start).fmu
        if file is None:
            raise InputRefused(f"{name}: is made of several FMUs already; name .fmu files")
        files.append(_own_copy(Path(file)))
    folder = files[0].parent
    mapping = _new_mapping_path(folder)
    if len(files) == 1:
        text, complete = proposal(described(files[0]))
    else:
        parts = dict(zip(part_names(files), map(described, files), strict=True))
        text, complete = parts_proposal(parts, folder)
    write_text(mapping, text)
    return mapping, complete


def _from_system(file: Path) -> tuple[Path, bool]:
    package = read_package(file)
    entries = _fmu_entries(package)
    folder = file.with_suffix("")
    mapping = _new_mapping_path(folder)
    make_folder(folder)
    names = dict(zip(entries, part_names(Path(part) for part in entries), strict=True))
    parts = {}
    for part, entry in entries.items():
        fmu = folder / f"{names[part]}.fmu"
        _write_fmu(fmu, package.content(entry))
        parts[names[part]] = described(fmu)
    wires = [wire for one in package.structure.system.connections if (wire := _known_wire(one, names))]
    text, complete = parts_proposal(parts, folder, wires)
    write_text(mapping, text)
    return mapping, complete


def _fmu_entries(package: Package) -> dict[str, str]:
    found = package.structure.system.elements
    if not found or len(found) > MAX_PARTS:
        raise InputRefused(f"{package.file}: {len(found)} parts; expected 1 to {MAX_PARTS}")
    entries = {}
    for part in found:
        source = part.source if isinstance(part, SspComponent) else ""
        entries[part.name] = package.entry(source)
        if not entries[part.name].endswith(".fmu"):
            raise InputRefused(
                f"{package.file}: part '{part.name}' is not an FMU inside this archive "
                f"({source or 'a system of its own'}); put the FMUs into one folder and name them all"
            )
    return entries


def _known_wire(connection: Connection, names: dict[str, str]) -> KnownWire | None:
    """Convert a connection of an SSP to a wire between parts; None if it involves the system's own connectors."""
    ends = connection.start, connection.end
    if not all(end.element for end in ends):
        return None
    scaled = connection.transformation.table or "LinearTransformation" * (
        connection.transformation != IDENTITY_TRANSFORMATION
    )
    source, target = (f"{names.get(end.element, end.element)}.{end.connector}" for end in ends)
    return KnownWire(source, target, f"it has a {scaled}" if scaled else "")


def _write_fmu(fmu: Path, content: bytes) -> None:
    if os.path.lexists(fmu):
        with open_regular(fmu, max(1, len(content))) as there:
            if there.read() == content:
                return
        raise InputRefused(f"{fmu}: exists, and is another file; move it away")
    write_bytes(fmu, content)


def _own_copy(fmu: Path) -> Path:
    """Return the path of an FMU; for an FMU of an installation, the path of a copy in the current folder."""
    if not fmu.is_relative_to(WHEEL_FOLDER):
        return fmu
    copy = Path.cwd() / fmu.stem / fmu.name
    _new_mapping_path(copy.parent)
    make_folder(copy.parent)
    _write_fmu(copy, fmu.read_bytes())
    return copy


def _new_mapping_path(folder: Path) -> Path:
    """Return the path of a new mapping.toml in a folder; refuse an existing one."""
    mapping = Path(os.path.relpath(folder / MAPPING_FILE))
    if os.path.lexists(mapping):
        raise InputRefused(f"{mapping}: exists, and is never overwritten; move it away for a new one")
    return mapping
