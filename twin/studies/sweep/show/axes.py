"""Which parameters are meant: across and up a sweep's map, and the one over which the worst is looked for."""

from twin.errors import InputRefused, nearest
from twin.studies.sweep.folder import KeptRows
from twin.studies.sweep.show.words import short
from twin.studies.sweep.statistics.ranking import numeric_labels


def axes_of(kept: KeptRows, x: str | None, y: str | None) -> tuple[str, str] | None:
    """The two parameters of the map: those asked for, else the first two that are numbers; None: there are not two.

    Raises:
        InputRefused: one asked for does not vary.
    """
    numeric = numeric_labels(kept.labels, kept.columns)
    names = short(kept.labels)
    chosen = []
    for option, wanted in (("--x", x), ("--y", y)):
        found = [label for label in numeric if wanted in (label, names[label])]
        if wanted is not None and not found:
            raise InputRefused(
                f"{option} {wanted}: no number that varies here; there are {', '.join(numeric) or 'none'}"
            )
        chosen.append(found[0] if found else None)
    free = [label for label in numeric if label not in chosen]
    first = chosen[0] or (free.pop(0) if free else None)
    second = chosen[1] or (free.pop(0) if free else None)
    return (first, second) if first and second and first != second else None


def worst_label(kept: KeptRows, wanted: str | None) -> str | None:
    """The parameter that `--worst-over` means, by its whole name or by its short one.

    Raises:
        InputRefused: none of that name varies.
    """
    names = short(kept.labels)
    found = next((label for label in kept.labels if wanted in (label, names[label])), None)
    if wanted is not None and found is None:
        raise InputRefused(f"--worst-over {wanted}: does not vary here; {nearest(wanted, kept.labels)}")
    return found
