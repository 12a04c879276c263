"""What came with FMUs as text of at most 80 columns."""

from collections.abc import Sequence

from twin.studies.lines import labelled, wrapped
from twin.studies.reference.agreement import TOLERANCE
from twin.studies.reference.outcome import BAD, References


def references_text(found: Sequence[References]) -> str:
    """What came with each FMU, then what came of it."""
    lines = []
    for one in found:
        lines += wrapped(f"came with {one.file.name}:")
        for file in one.carried.listed:
            what = f"{file.source}{'' if file.entry else ' (not in the FMU)'}  {file.description}"
            lines += wrapped(what.rstrip(), f"  has   {file.role:10} ", whole=True)
        for name, why in one.carried.unread:
            lines += wrapped(f"{name}: {why}", "  --    not read   ", whole=True)
        for outcome in one.outcomes:
            verdict = "FAIL" if outcome.word in BAD else "ok"
            lines += wrapped(
                f"{outcome.experiment}: {outcome.detail}", f"  {verdict:4}  {outcome.word:10} ", whole=True
            )
    if any(outcome.deviations for one in found for outcome in one.outcomes):
        lines += labelled("note", f"tolerance: {TOLERANCE}")
    return "\n".join(lines)
