"""Which parameters matter to a metric: rank correlations, and Sobol indices where the design allows them."""

from dataclasses import replace

from twin.studies.lines import counted
from twin.studies.sweep.columns import Columns
from twin.studies.sweep.folder import KeptRows
from twin.studies.sweep.show.table import Part
from twin.studies.sweep.show.words import interval, short
from twin.studies.sweep.statistics.correlation import FEW, Correlation, rank_correlation
from twin.studies.sweep.statistics.ranking import drives_in, numeric_labels, of_drive
from twin.studies.sweep.statistics.sobol_indices import LEAST_FOR_INTERVALS, Interval, sobol_indices, why_no_indices

WIDE = 0.3
"""Width of an interval that leaves open whether a parameter matters."""
COVERED = "the aim; on functions with known indices they held the truth 92 % of the times, the worst index 82 %"
"""Counted, see docs/sweep_show.md; tests/studies/sweep/statistics/test_sobol_indices.py counts a part of it again."""
SURE = 0.05
"""Chance of a mistake that a star allows for, over all parameters of a table together (Holm 1979)."""


def sensitivity_parts(kept: KeptRows, metric: str) -> list[Part]:
    """For each drive by itself: what moves one drive need not move another."""
    found: list[Part | None] = []
    drives = drives_in(kept.columns)
    for drive in drives:
        columns = kept.columns if len(drives) == 1 else kept.columns.at(of_drive(kept.columns, drive))
        of = f", {drive}" if len(drives) > 1 else ""
        found += [_correlations(kept, columns, metric, of), _indices(kept, columns, metric, of)]
    parts = [part for part in found if part is not None]
    if parts and (why := why_no_indices(kept.design)):
        parts[-1] = replace(parts[-1], remarks=[*parts[-1].remarks, why])
    return parts


def starred(correlations: dict[str, Correlation]) -> set[str]:
    """Parameters whose correlation is none by chance, all of them together at `SURE`.

    Source: Holm (1979), A simple sequentially rejective multiple test procedure.
    """
    stars: set[str] = set()
    ordered = sorted(correlations.items(), key=lambda item: item[1].p)
    for tested, (label, found) in enumerate(ordered):
        if found.p > SURE / (len(ordered) - tested):
            break
        stars.add(label)
    return stars


def _correlations(kept: KeptRows, columns: Columns, metric: str, of: str) -> Part | None:
    names = short(kept.labels)
    found = {
        label: correlation
        for label in numeric_labels(kept.labels, columns)
        if (correlation := rank_correlation(columns, label, metric))
    }
    if not found:
        return None
    stars = starred(found)
    lines = [
        [
            names[label],
            f"{one.rho:+.2f}{'*' if label in stars else ' '}",
            interval((one.low, one.high), "+.2f"),
            f"{one.p:.2g}",
        ]
        for label, one in sorted(found.items(), key=lambda item: -abs(item[1].rho))
    ]
    remarks = [f"* not by chance: 5 % for {counted(len(found), 'parameter')} together (Holm)"]
    fewest = min(one.runs for one in found.values())
    if fewest < FEW:
        remarks.append(f"only {fewest} runs: intervals are wide, and what has no star may matter all the same")
    title = f"rank correlation with {metric}{of} (Spearman: + rises with the parameter)"
    return Part("correlation", title, ["parameter", "rho ", "95 %", "p"], lines, remarks)


def _indices(kept: KeptRows, columns: Columns, metric: str, of: str) -> Part | None:
    if kept.design != "saltelli":
        return None
    found = sobol_indices(columns, kept.labels, kept.runs // max(1, len(kept.drives)), metric)
    title = f"Sobol indices of {metric}{of}, {found.blocks} of {found.planned} blocks"
    remarks = [found.remark] if found.remark else []
    if not found.of:
        return Part("indices", title, [], [], remarks)
    names = short(kept.labels)
    lines = [
        [names[one.label], f"{one.first:.2f}", _range(one.first_interval), f"{one.total:.2f}",
         _range(one.total_interval)]
        for one in sorted(found.of, key=lambda one: -one.total)
    ]  # fmt: skip
    ranges = [some for one in found.of for some in (one.first_interval, one.total_interval) if some]
    if ranges:
        remarks.append(f"95 %: {COVERED}")
    elif found.blocks < LEAST_FOR_INTERVALS:
        remarks.append(
            f"no intervals: of fewer than {LEAST_FOR_INTERVALS} blocks they hold much less often than they say"
        )
    if max((high - low for low, high in ranges), default=0.0) > WIDE:
        remarks.append("some intervals are wide: four times the blocks make them half as wide")
    remarks.append("first: share of the variance that it explains alone; total: together with others")
    return Part("indices", title, ["parameter", "first", "95 %", "total", "95 %"], lines, remarks)


def _range(found: Interval) -> str:
    return interval(found) if found else "-"
