"""What a sweep came to, part by part: a table each, which becomes text or a page."""

import math
from dataclasses import dataclass

from twin.errors import plain
from twin.studies.lines import counted
from twin.studies.sweep.columns import Positions
from twin.studies.sweep.folder import KeptRows
from twin.studies.sweep.show.claims import claims_part, least_sure
from twin.studies.sweep.show.sensitivity import sensitivity_parts
from twin.studies.sweep.show.table import Part
from twin.studies.sweep.show.words import number, short, shown
from twin.studies.sweep.statistics.claims import likelihoods
from twin.studies.sweep.statistics.distribution import BINS, QUANTILES, Spread, spread
from twin.studies.sweep.statistics.drives import drive_ranking
from twin.studies.sweep.statistics.pareto import pareto_front
from twin.studies.sweep.statistics.ranking import best, drives_in, metrics_in, value
from twin.studies.sweep.statistics.worst import worst_over

MOST_OF_FRONT = 8
MOST_REASONS = 5
MOST_WORST = 40
SHADES = " .:-=+*#"
"""Of a histogram's bins in text, from none to the fullest."""
SKETCH = "least to most"


@dataclass(frozen=True)
class Asked:
    """What a user wants to know.

    Attributes:
        by: metric that runs are ranked by.
        against: the other one of the Pareto front.
        top: so many best runs.
        worst_over: the parameter over which each choice of the others is judged by its worst run; None: none.
    """

    by: str
    against: str
    top: int
    worst_over: str | None = None


def parts(kept: KeptRows, asked: Asked) -> list[Part]:
    """Everything there is to say, most wanted first. In a sweep with claims these come first and no run is best: what
    is drawn there nobody can choose."""
    judged = claims_part(kept)
    found: list[Part | None] = [judged] if judged else [_best(kept, asked), _drives(kept, asked)]
    if asked.worst_over is not None:
        found.insert(0, _worst(kept, asked, asked.worst_over))
    found += sensitivity_parts(kept, asked.by)
    if not judged:
        found.append(_front(kept, asked))
    found += [_distributions(kept), _reasons(kept)]
    return [part for part in found if part is not None]


def headline(kept: KeptRows, by: str) -> str:
    """`NAME  20 runs: least force_error_N 0.31 (run 12); 2 failed`."""
    columns = kept.columns
    begun = "" if len(columns) == kept.runs else f"{len(columns)} of "
    text = f"{kept.name}  {begun}{counted(kept.runs, 'run')}"
    ranked = best(columns, by)
    if found := likelihoods(columns):
        text += f": {least_sure(found)}"
    elif len(ranked):
        text += f": least {by} {value(columns, by)[ranked[0]]:.3g} (run {columns.run(ranked[0])})"
    elif len(columns):
        text += ": none with " + by + (" keeps the limits" if kept.limits else "")
    statuses = columns.words("status").counts
    told = [f"{count} {status}" for status, count in sorted(statuses.items()) if status != "done"]
    if kept.limits:
        told.append(f"{columns.words('within_limits').counts.get(True, 0)} within limits")
    return text + "".join(f"; {one}" for one in told)


def _best(kept: KeptRows, asked: Asked) -> Part | None:
    ranked = best(kept.columns, asked.by)
    head, rows = _runs(kept, ranked[: asked.top], asked)
    return Part("best", f"best runs by {asked.by}", head, rows) if len(ranked) else None


def _worst(kept: KeptRows, asked: Asked, label: str) -> Part:
    columns, names = kept.columns, short(kept.labels)
    found = worst_over(columns, asked.by, label, kept.labels)
    others = [other for other in kept.labels if other != label]
    several = len(kept.drives) > 1
    rows = [
        [
            *(shown(columns.of.get(f"parameters/{other}"), one.row) for other in others),
            *([columns.words("drive")[one.row] or ""] if several else []),
            "failed" if math.isinf(one.metric) else number(one.metric),
            shown(columns.of.get(f"parameters/{label}"), one.row),
            str(one.runs),
            str(one.bad) if one.bad else "-",
        ]
        for one in found[:MOST_WORST]
    ]
    head = [*(names[other] for other in others), *(["drive"] if several else [])]
    head += [f"worst {asked.by}", f"at {names[label]}", "runs", "failed"]
    remarks = ["failed: also tripped, beyond a limit, or without that number; it counts as worst"]
    if len(found) > MOST_WORST:
        remarks.append(f"and {len(found) - MOST_WORST} more")
    if found and max(one.runs for one in found) == 1:
        remarks.append(f"each choice has one run: {names[label]} does not vary by itself, as it does in a grid")
    return Part("worst", f"worst {asked.by} over {names[label]}, least worst first", head, rows, remarks)


def _front(kept: KeptRows, asked: Asked) -> Part | None:
    front = pareto_front(kept.columns, asked.by, asked.against)
    if not len(front) or asked.by == asked.against:
        return None
    head, rows = _runs(kept, front[:MOST_OF_FRONT], asked)
    more = [f"and {len(front) - MOST_OF_FRONT} more"] if len(front) > MOST_OF_FRONT else []
    ranked = len(best(kept.columns, asked.by))
    title = f"Pareto front of {asked.by} and {asked.against}: {counted(len(front), 'run')} of {ranked}"
    return Part("front", title, head, rows, more)


def _runs(kept: KeptRows, rows: Positions, asked: Asked) -> tuple[list[str], list[list[str]]]:
    columns, names = kept.columns, short(kept.labels)
    metrics = list(dict.fromkeys((asked.by, asked.against)))
    several = len(kept.drives) > 1
    head = ["run", *metrics, *(["drive"] if several else []), *(names[label] for label in kept.labels)]
    return head, [
        [
            str(columns.run(row)),
            *(number(value(columns, metric)[row]) for metric in metrics),
            *([columns.words("drive")[row] or ""] if several else []),
            *(shown(columns.of.get(f"parameters/{label}"), row) for label in kept.labels),
        ]
        for row in rows
    ]


def _drives(kept: KeptRows, asked: Asked) -> Part | None:
    if len(drives_in(kept.columns)) < 2:
        return None
    scores = drive_ranking(kept.columns, asked.by)
    head = ["drive", "completed", "median", "worst", "behind, 95 %", "first, P"]
    rows = [
        [
            score.drive,
            f"{score.completed} of {score.runs}",
            number(score.median),
            number(score.worst),
            "-" if math.isnan(score.behind) else " .. ".join(f"{end:.3g}" for end in score.behind_interval),
            "-" if math.isnan(score.best) else f"{score.best:.2f}",
        ]
        for score in scores
    ]
    leader, *others = scores
    tied = [score.drive for score in others if not math.isnan(score.behind) and not score.told_apart]
    remarks = ["behind: median difference to the first, point by point; first, P: chance to rank first, both resampled"]
    if tied:
        remarks.append(f"not told apart from {leader.drive}: {', '.join(tied)}")
    return Part("drives", f"drives by {asked.by}", head, rows, remarks)


def _distributions(kept: KeptRows) -> Part | None:
    spreads = [found for metric in metrics_in(kept.columns) if (found := spread(kept.columns, metric))]
    if not spreads or len(kept.columns) < 2:
        return None
    head = ["metric", *(f"{100 * share:g} %" for share in QUANTILES), SKETCH, "missing"]
    rows = [
        [one.metric, *map(number, one.quantiles), f"|{_shades(one):{BINS}}|", str(one.missing) if one.missing else "-"]
        for one in spreads
    ]
    return Part("metrics", "each metric over all runs, quantiles", head, rows, text_only=(SKETCH,))


def _shades(found: Spread) -> str:
    """A histogram in characters."""
    fullest = max(found.counts)
    return "".join(SHADES[math.ceil(count / fullest * (len(SHADES) - 1))] for count in found.counts)


def _reasons(kept: KeptRows) -> Part | None:
    reasons: dict[tuple[str, str], list[int]] = {}
    columns = kept.columns
    rows = columns.words("status").are(lambda status: status != "done")
    words = [columns.words(name).at(rows) for name in ("status", "reason")]
    for run, status, reason in zip(columns.numbers("run")[rows], *words, strict=True):
        reasons.setdefault((status, "".join(reason.splitlines()[:1])), []).append(int(run))
    if not reasons:
        return None
    most_first = sorted(reasons.items(), key=lambda item: -len(item[1]))
    told = []
    for (status, reason), runs in most_first[:MOST_REASONS]:
        others = f" and {counted(len(runs) - 1, 'other')}" if len(runs) > 1 else ""
        told.append(plain(f"run {runs[0]}{others} {status}: {reason}"))
    if len(reasons) > MOST_REASONS:
        told.append(f"{len(reasons) - MOST_REASONS} other reasons are in the rows")
    return Part("reasons", "runs that are not done", [], [], told)
