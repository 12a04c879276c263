"""A mapping.toml to start from: complete where an FMU leaves no doubt, else with the doubtful lines commented."""

import json
from collections.abc import Mapping, Sequence
from contextlib import suppress

from twin.drive.contract import COMMANDS, Command, Role, contract
from twin.drive.description import FmuDescription
from twin.drive.mapping import Choice, Wiring, bindings, candidates, choice, likely_command, score
from twin.drive.variable import Variable
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
    command, found, sure = understood(description.path.name, description.variables)
    doubt = "" if sure else "   # or one of: " + ", ".join(f'"{other}"' for other in COMMANDS if other != command)
    head = [
        f"# How the drive contract's roles are filled by {visible(description.path.name)}, in its own names and units.",
        f"fmu = {quoted(description.path.name)}",
        f'sha256 = "{description.sha256}"',
        f'command = "{command}"{doubt}',
        "sign = 1                  # -1 if it turns the other way: twin drive check tells",
        "gear_ratio = 1.0          # turns of its shaft per turn of the robot's motor shaft",
    ]
    text = "\n".join(head) + "\n" + roles_text(description.variables, found, command)
    if command not in ("velocity", "position"):
        text += LOOP.format(unit=COMMANDS[command].port.unit)
    return text, sure and command in ("velocity", "position")


def understood(file: str, variables: Mapping[str, Variable]) -> tuple[Command, Choice, bool]:
    """(what a drive is commanded with, who plays which role, whether nothing is in doubt).

    Args:
        file: what an error would call it.
        variables: by the name the user knows them by.
    """
    fitting: list[Command] = []
    for command in COMMANDS:
        with suppress(InputRefused):
            bindings(file, variables, Wiring(command))
            found = _choice(file, variables, command)
            name = found.chosen[COMMANDS[command].port.name]
            # a lone torque beside a voltage may be another load
            if score(name, variables[name], COMMANDS[command]) > 0:
                return command, found, True
            fitting.append(command)
    if fitting:
        return fitting[0], _choice(file, variables, fitting[0]), len(fitting) == 1
    command = likely_command(variables, _choice(file, variables, "velocity").chosen.values())
    return command, _choice(file, variables, command), False


def roles_text(variables: Mapping[str, Variable], found: Choice, command: Command) -> str:
    """The tables [inputs] and [outputs]."""
    return "".join(_table(variables, found, contract(command), side) for side in ("input", "output"))


def _choice(file: str, variables: Mapping[str, Variable], command: Command) -> Choice:
    return choice(file, variables, Wiring(command), contract(command))


def _table(variables: Mapping[str, Variable], found: Choice, roles: Sequence[Role], side: str) -> str:
    lines = ["", f"[{side}s]"]
    for role in roles:
        if role.causality == side:
            name = found.chosen.get(role.port.name)
            lines += [_line(role, name, variables[name])] if name else _doubtful_lines(variables, found, role)
    return "\n".join(lines) + "\n"


def _doubtful_lines(variables: Mapping[str, Variable], found: Choice, role: Role) -> list[str]:
    """The only candidate as it is, several as comments; optional roles not at all."""
    if not role.required:
        return []
    offered = candidates(variables, role, found.chosen.values())
    if not offered:
        return [f'# {role.port.name} = "?"   # {role.port.meaning}: no {role.causality} measures {role.port.unit}']
    return [("# " if len(offered) > 1 else "") + _line(role, name, variables[name]) for name in offered]


def _line(role: Role, name: str, variable: Variable) -> str:
    text = " ".join(filter(None, (f"[{variable.unit or 'no unit'}]", *variable.description.split())))
    return f"{role.port.name} = {quoted(name)}   # {visible(text)}"


def quoted(name: str) -> str:
    """A name as a TOML string."""
    return json.dumps(name, ensure_ascii=False)
