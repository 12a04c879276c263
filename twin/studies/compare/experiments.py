"""What differs in the experiments of two runs that are compared."""

from pathlib import Path

from twin.errors import InputRefused
from twin.experiment.difference import differing, recorded_facts
from twin.recording.logs.reader import is_recording
from twin.recording.origin import origin
from twin.runs.assembly.declared import DECLARED
from twin.studies.lines import counted, cut, wrapped

FEW = 8
"""Differences that are told; the JSON has all."""
LONG = 24
"""Characters of a value that are told."""

Differences = dict[str, tuple[str, ...]]


def experiments_differ(a: Path, b: Path) -> Differences | None:
    """(in A, in B) of what is not the same, by key; None: one of them is no run of the twin, and says of none."""
    if not (is_recording(a) and is_recording(b)):
        return None
    try:
        found = [origin(path) for path in (a, b)]
        if any("experiment" not in metadata for metadata in found):
            return None
        return differing(
            [recorded_facts(DECLARED, metadata, path) for metadata, path in zip(found, (a, b), strict=True)]
        )
    except InputRefused:
        return None


def differences_text(differences: Differences | None) -> list[str]:
    """Lines for the end of a comparison; none if there is nothing to say of experiments."""
    if differences is None:
        return []
    if not differences:
        return ["", "Nothing differs in the experiments."]
    lines = ["", "What differs in the experiments, A and B:"]
    for key, values in list(differences.items())[:FEW]:
        lines += wrapped(" and ".join(cut(value, LONG) for value in values), f"  {key}  ", later=6, whole=True)
    more = len(differences) - FEW
    return [*lines, *([f"  and {counted(more, 'more value')}"] if more > 0 else [])]
