from pathlib import Path

import pytest

from twin.faults import command_fault, count_fault, drive_fault, message_fault, parameter_fault
from twin.faults.catalogue import CATALOGUE
from twin.faults.kind import Kind

NO_MAGNITUDE = "none"


def rows(kinds: dict[str, Kind]) -> list[str]:
    """The catalogue as the rows of a markdown table."""
    return [f"| {' | '.join(cells(name, known))} |" for name, known in kinds.items()]


def cells(name: str, known: Kind) -> list[str]:
    targets = ", ".join(f"`{target}`" for target in known.targets)
    magnitudes = ", ".join(f"{value:g}" for value in known.magnitudes or ())
    key = f"`{known.magnitude_key}`" if known.magnitude_key else NO_MAGNITUDE
    return [f"`{name}`", known.meaning, targets, key, magnitudes or "-", known.detection, known.reason]


def test_the_table_in_the_documentation_is_the_catalogue(root: Path):
    lines = (root / "docs" / "faults.md").read_text().splitlines()
    assert [line for line in lines if line.startswith("| `") and line.count(" | ") == 6] == rows(CATALOGUE)


@pytest.mark.parametrize(
    ("mechanism", "kinds"),
    [
        ("counts", count_fault.LAWS),
        ("message", message_fault.KINDS),
        ("command", command_fault.KINDS),
        ("drive", drive_fault.LAWS),
        ("parameter", parameter_fault.PARAMETERS),
    ],
)
def test_each_mechanism_does_its_kinds_and_no_others(mechanism, kinds):
    assert set(kinds) == {name for name, known in CATALOGUE.items() if known.mechanism == mechanism}


@pytest.mark.parametrize("kind", CATALOGUE)
def test_a_kind_has_three_different_magnitudes_or_none_and_a_key_for_them(kind):
    known = CATALOGUE[kind]
    assert (known.magnitudes is None) == (known.magnitude_key is None)
    assert len(set(known.magnitudes or (1.0, 2.0, 3.0))) == 3


@pytest.mark.parametrize("kind", CATALOGUE)
def test_a_kind_names_its_targets_and_says_why_it_is_detected_or_not(kind):
    known = CATALOGUE[kind]
    assert known.targets and known.meaning and known.reason
    assert len(set(known.targets)) == len(known.targets)
