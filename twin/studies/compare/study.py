"""A comparison, from two logs to files: picture, facts."""

from collections.abc import Sequence
from pathlib import Path

from twin.errors import InputRefused
from twin.studies.answer import Answer, judged
from twin.studies.compare.alignment import alignment
from twin.studies.compare.comparison import compared
from twin.studies.compare.experiments import differences_text, experiments_differ
from twin.studies.compare.inputs import both
from twin.studies.compare.picture import draw_comparison
from twin.studies.compare.text import comparison_text
from twin.studies.compare.tolerance import rules
from twin.studies.steps import Say

HOME = Path("results") / "compare"


def compare(
    paths: Sequence[Path],
    signals: Sequence[str],
    tolerances: Sequence[str],
    maps: Sequence[str],
    align: tuple[str, str, float],
    partial: bool,
    out: Path | None,
    say: Say,
) -> Answer:
    """Whether the second of two logs stays within a tube around the first, and files in `out`, or results/compare.

    Exit code 1: it does not, or it lacks a part of the first one's time.

    Args:
        paths: two logs, see `read_log`.
        signals: see `compared`.
        tolerances: see `rules`.
        maps: see `column_map`.
        align: see `alignment`.
        partial: the second may cover a part of the time only.
        out: folder; None: results/compare.
        say: told what is being done.

    Raises:
        InputRefused: not two logs, or one of them, the options or the folder cannot be used.
        NotWritten: the disk refuses.
    """
    if len(paths) != 2:
        raise InputRefused(
            f"twin compare: got {len(paths)} path{'s' * (len(paths) != 1)}, expected A and B, or --paper FIGURE"
        )
    found = compared(*both(paths[0], paths[1], maps), rules(tolerances), signals, alignment(*align))
    covered = partial or found.least_covered[1] == 1.0
    differ = experiments_differ(found.a, found.b)
    text = "\n".join([comparison_text(found, partial), *differences_text(differ)])
    facts = found.facts() | {"experiments": differ}
    return judged("compare", out or HOME, text, facts, lambda path: draw_comparison(found, path),
                  holds=covered and not found.outside)  # fmt: skip
