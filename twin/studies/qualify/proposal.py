"""A mapping.toml to start from: complete where an FMU leaves no doubt, else with the doubtful lines commented."""

import difflib
from collections.abc import Sequence

from twin.drive.contract import COMMANDS, LOAD, OUTPUTS, Command, Role
from twin.drive.description import FmuDescription, Variable
from twin.drive.mapping import Binding, Wiring, bindings, measures
from twin.errors import InputRefused

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
    command, bound = _understood(description)
    doubt = "" if bound else "   # or one of: " + ", ".join(f'"{other}"' for other in COMMANDS if other != command)
    head = [
        f"# How the drive contract's roles are filled by {description.path.name}, in its own names and units.",
        f'fmu = "{description.path.name}"',
        f'sha256 = "{description.sha256}"',
        f'command = "{command}"{doubt}',
        "sign = 1                  # -1 if it turns the other way: twin drive check tells",
        "gear_ratio = 1.0          # turns of its shaft per turn of the robot's motor shaft",
    ]
    roles = (COMMANDS[command], LOAD, *OUTPUTS)
    tables = [_table(description, bound, roles, side) for side in ("input", "output")]
    text = "\n".join(head) + "\n" + "".join(tables)
    if command not in ("velocity", "position"):
        text += LOOP.format(unit=COMMANDS[command].port.unit)
    return text, bool(bound) and command in ("velocity", "position")


def _understood(description: FmuDescription) -> tuple[Command, tuple[Binding, ...]]:
    """The command with which every required role has one answer, and the answers; none if there is no such command."""
    for command in COMMANDS:
        try:
            return command, bindings(description.path.name, description.variables, Wiring(command))
        except InputRefused:
            continue
    load = _candidates(description, LOAD)
    # the only torque that goes in is the load
    free = {command: [v for v in _candidates(description, role) if [v] != load] for command, role in COMMANDS.items()}
    return next((command for command, left in free.items() if left), "velocity"), ()


def _table(description: FmuDescription, bound: Sequence[Binding], roles: Sequence[Role], side: str) -> str:
    lines = ["", f"[{side}s]"]
    for role in roles:
        if role.causality == side:
            known = [_line(role, b.variable) for b in bound if b.role == role]
            lines += known if bound else _doubtful_lines(role, _candidates(description, role))
    return "\n".join(lines) + "\n"


def _doubtful_lines(role: Role, candidates: list[Variable]) -> list[str]:
    """The only candidate as it is, several as comments; optional roles only if there is exactly one named like them."""
    if not role.required:
        return [_line(role, v) for v in candidates if v.name == role.port.name]
    if not candidates:
        return [f'# {role.port.name} = "?"   # {role.port.meaning}: no {role.causality} measures {role.port.unit}']
    return [("# " if len(candidates) > 1 else "") + _line(role, v) for v in candidates]


def _line(role: Role, variable: Variable) -> str:
    text = " ".join(filter(None, (f"[{variable.unit or 'no unit'}]", variable.description)))
    return f'{role.port.name} = "{variable.name}"   # {text}'


def _candidates(description: FmuDescription, role: Role) -> list[Variable]:
    """Variables whose causality and unit allow `role`, most similar names first; locals if no output does."""
    causalities = (role.causality, "local") if role.causality == "output" else (role.causality,)
    offered = [[v for v in description.offered(causality) if measures(v, role)] for causality in causalities]
    fitting = next((found for found in offered if found), [])
    fitting = [v for v in fitting if v.unit] or fitting
    names = (role.port.name, *role.synonyms)
    return sorted(
        fitting, key=lambda v: -max(difflib.SequenceMatcher(None, v.name.lower(), name).ratio() for name in names)
    )
