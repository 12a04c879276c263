"""A mapping.toml to start from: complete where an FMU leaves no doubt, else with the doubtful lines commented."""

import json
from collections.abc import Sequence
from contextlib import suppress

from twin.drive.contract import COMMANDS, LOAD, OPTIONAL_INPUTS, OUTPUTS, Command, Role
from twin.drive.description import FmuDescription, Variable
from twin.drive.mapping import Choice, Wiring, bindings, candidates, choice, likely_command
from twin.errors import InputRefused, visible

LOOP = """
[velocity_loop]           # ours, in front of a drive that takes no speed; tune it, then remove the #
# kp = 0.1                # {unit} per rad/s
# ki = 1.0                # {unit} per rad
# limit = 1.0             # {unit}
# period_ms = 0.25
"""


def proposal(description: FmuDescription) -> tuple[str, bool]:
    """(text of a mapping.toml that stands beside the FMU, whether it is complete as it is).

    It pins the FMU by its hash.
    """
    command, found, sure = _understood(description)
    doubt = "" if sure else "   # or one of: " + ", ".join(f'"{other}"' for other in COMMANDS if other != command)
    head = [
        f"# How the drive contract's roles are filled by {description.path.name}, in its own names and units.",
        f'fmu = "{description.path.name}"',
        f'sha256 = "{description.sha256}"',
        f'command = "{command}"{doubt}',
        "sign = 1                  # -1 if it turns the other way: twin drive check tells",
        "gear_ratio = 1.0          # turns of its shaft per turn of the robot's motor shaft",
    ]
    roles = _roles(command)
    tables = [_table(description, found, roles, side) for side in ("input", "output")]
    text = "\n".join(head) + "\n" + "".join(tables)
    if command not in ("velocity", "position"):
        text += LOOP.format(unit=COMMANDS[command].port.unit)
    return text, sure and command in ("velocity", "position")


def _understood(description: FmuDescription) -> tuple[Command, Choice, bool]:
    """(what it is commanded with, who plays which role, whether nothing is in doubt)."""
    file, variables = description.path.name, description.variables
    for command in COMMANDS:
        with suppress(InputRefused):
            bindings(file, variables, Wiring(command))
            return command, _choice(description, command), True
    command = likely_command(variables, _choice(description, "velocity").chosen.values())
    return command, _choice(description, command), False


def _choice(description: FmuDescription, command: Command) -> Choice:
    return choice(description.path.name, description.variables, Wiring(command), _roles(command))


def _roles(command: Command) -> tuple[Role, ...]:
    return COMMANDS[command], LOAD, *OPTIONAL_INPUTS, *OUTPUTS


def _table(description: FmuDescription, found: Choice, roles: Sequence[Role], side: str) -> str:
    lines = ["", f"[{side}s]"]
    for role in roles:
        if role.causality == side:
            name = found.chosen.get(role.port.name)
            lines += [_line(role, description.variables[name])] if name else _doubtful_lines(description, found, role)
    return "\n".join(lines) + "\n"


def _doubtful_lines(description: FmuDescription, found: Choice, role: Role) -> list[str]:
    """The only candidate as it is, several as comments; optional roles not at all."""
    if not role.required:
        return []
    offered = candidates(description.variables, role, found.chosen.values())
    if not offered:
        return [f'# {role.port.name} = "?"   # {role.port.meaning}: no {role.causality} measures {role.port.unit}']
    return [("# " if len(offered) > 1 else "") + _line(role, description.variables[name]) for name in offered]


def _line(role: Role, variable: Variable) -> str:
    text = " ".join(filter(None, (f"[{variable.unit or 'no unit'}]", *variable.description.split())))
    return f"{role.port.name} = {quoted(variable.name)}   # {visible(text)}"


def quoted(name: str) -> str:
    """A name as a TOML string."""
    return json.dumps(name, ensure_ascii=False)
