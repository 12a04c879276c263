from pathlib import Path

import pytest

from twin.robot.experiment.fault import (
    ALWAYS_DETECTED,
    ANY_MAGNITUDE,
    FAULT_KINDS,
    NEVER_DETECTED,
    DetectionThreshold,
    FaultKind,
)

NO_MAGNITUDE = "none"


def rows(kinds: dict[str, FaultKind]) -> list[str]:
    """The catalogue as the rows of a markdown table."""
    return [f"| {' | '.join(cells(name, known))} |" for name, known in kinds.items()]


def cells(name: str, known: FaultKind) -> list[str]:
    targets = ", ".join(f"`{target}`" for target in known.targets)
    magnitudes = ", ".join(f"{value:g}" for value in known.magnitudes or ())
    key = f"`{known.magnitude_key}`" if known.magnitude_key else NO_MAGNITUDE
    beyond = "-" if known.excess_from is None else f"{known.excess_from:g}"
    return [f"`{name}`", known.meaning, targets, key, magnitudes or "-", told(known.threshold), beyond, known.reason]


def told(seen: DetectionThreshold) -> str:
    """`yes`, `no`, `from 2`, `free: from -10, in contact: from -30`."""
    places = {"free": seen.free, "in contact": seen.contact}
    if seen in (ALWAYS_DETECTED, NEVER_DETECTED):
        return "yes" if seen == ALWAYS_DETECTED else "no"
    words = {
        place: "no" if m is None else "yes" if m == ANY_MAGNITUDE else f"from {m:g}" for place, m in places.items()
    }
    if len(set(words.values())) == 1:
        return words["free"]
    return ", ".join(f"{place}: {word}" for place, word in words.items())


def test_the_table_in_the_documentation_is_the_catalogue(root: Path):
    lines = (root / "docs" / "faults_reference.md").read_text().splitlines()
    assert [line for line in lines if line.startswith("| `") and line.count(" | ") == 7] == rows(FAULT_KINDS)


@pytest.mark.parametrize("kind", FAULT_KINDS)
def test_a_kind_has_three_different_magnitudes_or_none_and_a_key_for_them(kind):
    known = FAULT_KINDS[kind]
    assert (known.magnitudes is None) == (known.magnitude_key is None)
    assert len(set(known.magnitudes or (1.0, 2.0, 3.0))) == 3


@pytest.mark.parametrize("kind", FAULT_KINDS)
def test_a_kind_names_its_targets_and_says_why_it_is_detected_or_not(kind):
    known = FAULT_KINDS[kind]
    assert known.targets and known.meaning and known.reason
    assert len(set(known.targets)) == len(known.targets)


@pytest.mark.parametrize("kind", FAULT_KINDS)
def test_what_is_said_of_a_kind_is_said_of_magnitudes_that_the_matrix_has(kind):
    known = FAULT_KINDS[kind]
    said = {known.threshold.free, known.threshold.contact, known.excess_from} - {None, ANY_MAGNITUDE}
    assert said <= set(known.magnitudes or ())


def test_larger_than_said_is_further_in_the_list_whichever_way_the_numbers_go():
    slip = FAULT_KINDS["belt_slip"]
    assert [slip.expects_detection(m, False) for m in (-2.0, -10.0, -30.0)] == [False, True, True]
    assert [slip.expects_detection(m, True) for m in (-2.0, -10.0, -30.0)] == [False, False, True]
    assert [FAULT_KINDS["drive_saturation"].expects_detection(m, True) for m in (2.0, 0.3, 0.05)] == [False, True, True]
    assert [FAULT_KINDS["joint_jam"].expects_detection(None, where) for where in (False, True)] == [True, False]
    assert [FAULT_KINDS["encoder_drift"].expects_excess(m) for m in (0.1, 0.5, 2.0)] == [False, False, True]


def test_a_kind_is_detectable_always_somewhere_or_never():
    assert [FAULT_KINDS[kind].detection for kind in ("drive_dead", "joint_jam", "breathing")] == [
        "yes",
        "if large",
        "no",
    ]
