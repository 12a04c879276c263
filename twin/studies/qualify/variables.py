"""What an FMU has, for whoever has to say which of its variables plays which role."""

from collections.abc import Mapping
from typing import Any

from twin.drive.contract import OUTPUTS
from twin.drive.description import FmuDescription
from twin.drive.mapping import candidates
from twin.drive.variable import Variable
from twin.errors import visible
from twin.studies.lines import wrapped

MOST = 60
"""Variables of a causality that are listed; a body in a few thousand helps nobody."""


def variables_text(parts: Mapping[str, FmuDescription]) -> str:
    """The inputs and outputs of each part; of what is local, what its shaft may be where no output can.

    Args:
        parts: FMUs by part; "" for the only one.
    """
    lines: list[str] = []
    for part, fmu in parts.items():
        for causality, variables in _listed(fmu).items():
            lines.append(f"{part or fmu.path.name}: {len(variables) or 'no'} {causality}{'s' * (len(variables) != 1)}")
            longest = max((len(visible(v.name)) for v in variables[:MOST]), default=0)
            for v in variables[:MOST]:
                head = f"  {visible(v.name):{min(longest, 32)}}  {v.type:8} {f'[{v.unit}]' if v.unit else '-':10} "
                lines += wrapped(v.description, head) or [head.rstrip()]
            lines += [f"  and {len(variables) - MOST} more"] if len(variables) > MOST else []
    return "\n".join(lines)


def variables_facts(parts: Mapping[str, FmuDescription]) -> list[dict[str, Any]]:
    """The same for JSON, all of them."""
    return [
        {
            "part": part, "name": v.name, "causality": causality, "type": v.type, "unit": v.unit or None,
            "description": v.description,
        }
        for part, fmu in parts.items()
        for causality, variables in _listed(fmu).items()
        for v in variables
    ]  # fmt: skip


def _listed(fmu: FmuDescription) -> dict[str, list[Variable]]:
    found = {c: [v for v in fmu.variables.values() if v.causality == c] for c in ("input", "output")}
    shaft = dict.fromkeys(name for role in OUTPUTS if role.required for name in candidates(fmu.variables, role))
    local = [v for name in shaft if (v := fmu.variables[name]).causality == "local"]
    return found | ({"local variable": local} if local else {})
