"""docs/roles.md has the ports of every part that may be third-party, as the robot's table has them."""

import re
from pathlib import Path

import pytest

from twin.robot.assembly.roles import ROLE_CONTRACTS


@pytest.mark.parametrize("role", ROLE_CONTRACTS)
def test_the_page_has_the_ports_of_a_part(root: Path, role: str):
    page = (root / "docs" / "roles.md").read_text().partition("## The ports")[2]
    section = re.split(r"\n##+ ", page.partition(f"### `{role}`\n")[2])[0]
    written = [
        tuple(c.strip() for c in line.strip("|").split("|")) for line in section.splitlines() if line.startswith("| `")
    ]
    contract = ROLE_CONTRACTS[role]
    true = [(f"`{p.name}`", "input", str(p.size), p.unit, p.meaning) for p in contract.inputs]
    for p in contract.outputs:
        needed = "output, needed" if p.name in contract.required else "output"
        true.append((f"`{p.name}`", needed, str(p.size), p.unit, p.meaning))
    assert written == true
