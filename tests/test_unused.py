"""No definition of twin/ is unused, but for those listed in unused.txt beside this file, with who uses them."""

from pathlib import Path

import pytest

LIST = Path(__file__).with_name("unused.txt")
# commands, validators and overloads are registered by their decorators
REGISTERED = ["@study", "@study.*", "@field_validator", "@model_validator", "@overload", "@overload_*"]


def listed() -> set[str]:
    lines = (line.partition("#")[0] for line in LIST.read_text(encoding="utf-8").splitlines())
    return {name.strip() for line in lines for name in line.split(",") if name.strip()}


def unused(folder: Path) -> dict[str, str]:
    """Places by name."""
    vulture = pytest.importorskip("vulture")
    found = vulture.Vulture(ignore_decorators=REGISTERED)
    found.scavenge([str(folder)])
    return {item.name: f"{item.filename}:{item.first_lineno}" for item in found.get_unused_code(min_confidence=60)}


@pytest.mark.slow
def test_every_definition_is_used_or_listed(root: Path):
    found = unused(root / "twin")
    more = {name: found[name] for name in found.keys() - listed()}
    assert more == {}, f"delete them, or say in {LIST.name} who uses them"


def test_a_definition_that_nothing_uses_is_found(tmp_path: Path):
    (tmp_path / "module.py").write_text("def used():\n    pass\n\n\ndef forgotten():\n    used()\n")
    assert unused(tmp_path).keys() == {"forgotten"}
