"""What a sweep came to, in 80 columns: answer first, then reasons, then where files are."""

import math
import textwrap
from collections import Counter
from collections.abc import Sequence

from twin.sweep.folder import Kept
from twin.sweep.rows import Row
from twin.sweep.statistics import best, drive_ranking, is_number, pareto_front, rank_correlation, value

WIDTH = 80
MOST_REASONS = 5
MOST_OF_FRONT = 8


def sweep_text(kept: Kept, by: str, against: str, top: int) -> str:
    """The report of a sweep.

    Args:
        by: metric that runs are ranked by. against: the other one of the Pareto front. top: so many best runs.
    """
    lines = [headline(kept, by)]
    ranked = best(kept.rows, by)
    if ranked:
        lines += ["", f"best runs by {by}", *_table(kept, ranked[:top], (by, against))]
    if len({row["drive"] for row in kept.rows}) > 1:
        lines += ["", f"drives by {by}", *_drives(kept.rows, by)]
    if correlations := _correlations(kept):
        lines += ["", "rank correlation (Spearman: -1 falls, +1 rises with the parameter)", *correlations]
    if len(ranked) > 1:
        front = pareto_front(kept.rows, by, against)
        lines += ["", f"Pareto front of {by} and {against}: {_count(len(front), 'run')} of {len(ranked)}"]
        lines += _table(kept, front[:MOST_OF_FRONT], (by, against))
        if len(front) > MOST_OF_FRONT:
            lines.append(f"  ... and {len(front) - MOST_OF_FRONT} more")
    lines += _reasons(kept.rows)
    return "\n".join(line.rstrip() for line in lines)


def headline(kept: Kept, by: str) -> str:
    """`NAME  20 runs: least force_error_N 0.31 (run 12); 2 failed`."""
    ranked = best(kept.rows, by)
    begun = "" if len(kept.rows) == kept.runs else f"{len(kept.rows)} of "
    text = f"{kept.name}  {begun}{_count(kept.runs, 'run')}"
    if ranked:
        text += f": least {by} {value(ranked[0], by):.3g} (run {ranked[0]['run']})"
    elif kept.rows:
        text += ": none with " + by + (" keeps the limits" if kept.limits else "")
    statuses = Counter(row["status"] for row in kept.rows if row["status"] != "done")
    parts = [f"{count} {status}" for status, count in sorted(statuses.items())]
    if kept.limits:
        parts.append(f"{sum(row['within_limits'] is True for row in kept.rows)} within limits")
    return _folded(text + "".join(f"; {part}" for part in parts))


def short(labels: Sequence[str]) -> dict[str, str]:
    """Each label by as few of its last parts as tell it from the others."""
    names = {}
    for label in labels:
        parts = label.split(".")
        for count in range(1, len(parts) + 1):
            name = ".".join(parts[-count:])
            if sum(other == name or other.endswith(f".{name}") for other in labels) == 1:
                break
        names[label] = name
    return names


def _table(kept: Kept, rows: Sequence[Row], metrics: Sequence[str]) -> list[str]:
    names = short(kept.labels)
    several = len({row["drive"] for row in kept.rows}) > 1
    columns: list[list[str]] = [["run", *(str(row["run"]) for row in rows)]]
    columns += [[metric, *(_number(value(row, metric)) for row in rows)] for metric in dict.fromkeys(metrics)]
    if several:
        columns.append(["drive", *(row["drive"] or "" for row in rows)])
    for label in kept.labels:
        columns.append([names[label], *(_shown(row["parameters"].get(label)) for row in rows)])
    return _aligned(columns)


def _drives(rows: Sequence[Row], by: str) -> list[str]:
    scores = drive_ranking(rows, by)
    return _aligned([
        ["drive", *(score.drive for score in scores)],
        ["completed", *(f"{score.completed} of {score.runs}" for score in scores)],
        ["median", *(_number(score.median) for score in scores)],
        ["worst", *(_number(score.worst) for score in scores)],
        ["best at", *(_count(score.wins, "point") for score in scores)],
    ])  # fmt: skip


def _correlations(kept: Kept) -> list[str]:
    names = short(kept.labels)
    metrics = [metric for metric in kept.metrics if metric != "peak_time_s"]
    numeric = [label for label in kept.labels if any(is_number(row["parameters"].get(label)) for row in kept.rows)]
    found = {label: [rank_correlation(kept.rows, label, metric) for metric in metrics] for label in numeric}
    if all(math.isnan(number) for numbers in found.values() for number in numbers):
        return []
    columns = [["", *(names[label] for label in numeric)]]
    for position, metric in enumerate(metrics):
        cells = [found[label][position] for label in numeric]
        columns.append([metric, *("-" if math.isnan(cell) else f"{cell:+.2f}" for cell in cells)])
    return _aligned(columns)


def _reasons(rows: Sequence[Row]) -> list[str]:
    reasons: dict[tuple[str, str], list[int]] = {}
    for row in rows:
        if row["status"] != "done":
            reasons.setdefault((row["status"], row["reason"].splitlines()[0]), []).append(row["run"])
    lines = [""] if reasons else []
    most_first = sorted(reasons.items(), key=lambda item: -len(item[1]))
    for (status, reason), runs in most_first[:MOST_REASONS]:
        others = f" and {_count(len(runs) - 1, 'other')}" if len(runs) > 1 else ""
        lines.append(_folded(f"run {runs[0]}{others} {status}: {reason}", "  "))
    if len(reasons) > MOST_REASONS:
        lines.append(f"{len(reasons) - MOST_REASONS} other reasons are in the rows")
    return lines


def _aligned(columns: list[list[str]]) -> list[str]:
    """Lines of a table; columns that do not fit in 80 are left out, and said to be."""
    lines = ["  "] * len(columns[0])
    left_out = 0
    for number, column in enumerate(columns):
        width = max(map(len, column))
        if len(lines[0]) + width > WIDTH:
            left_out = len(columns) - number
            break
        first = number == 0
        lines = [
            line + (f"{cell:<{width}}" if first else f"{cell:>{width}}") + "  "
            for line, cell in zip(lines, column, strict=True)
        ]
    return [*lines, f"  ({_count(left_out, 'more column')} in --json)"] if left_out else lines


def _folded(text: str, indent: str = "  ") -> str:
    return "\n".join(textwrap.wrap(text, WIDTH, subsequent_indent=indent, break_on_hyphens=False))


def _number(number: float) -> str:
    return "-" if math.isnan(number) else "0" if abs(number) < 1e-9 else f"{number:.4g}"


def _shown(parameter: object) -> str:
    if parameter is None:
        return "-"
    return f"{parameter:.4g}" if isinstance(parameter, float) else str(parameter)


def _count(number: int, noun: str) -> str:
    return f"{number} {noun}{'' if number == 1 else 's'}"
