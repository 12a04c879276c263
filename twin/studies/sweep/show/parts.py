"""The report of a sweep as tables with remarks, most important first, and as text."""

import math
from collections import Counter
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, replace

import numpy as np

from twin.kernel.errors import InputRefused, nearest, terminal_text
from twin.studies.result import Block, Column, Note, Table, count_text, lay_out
from twin.studies.sweep.columns import Columns, Positions
from twin.studies.sweep.measures import (
    BY_COLUMN,
    FELT_STIFFNESS,
    HOLD_ERROR,
    HOLD_OVERSHOOT,
    SETTLING_TIME,
    SINCE_TOUCH,
)
from twin.studies.sweep.statistics import ranking, sensitivity
from twin.studies.sweep.statistics.ranking import HISTOGRAM_BINS, value, worst_over
from twin.studies.sweep.stored import SweepRows

LIKELY_SHARE = 0.95
"""Minimum share of successful runs for a claim to be called likely."""
MEDIAN_INDEX = ranking.QUANTILES.index(0.5)
WIDE_INTERVAL = 0.3
"""Width of a confidence interval above which it stays open whether a parameter matters."""
COVERAGE_NOTE = "the aim; on functions with known indices they held the truth 92 % of the times, the worst index 82 %"
"""Empirical coverage, see docs/sweep.md; tests/studies/sweep/statistics/test_sensitivity.py repeats a part."""
FAMILYWISE_LEVEL = 0.05
"""Familywise error rate of the stars, over all parameters of a table together (Holm 1979)."""
MAX_EQUAL_ROWS = 12
COMPANION_TITLES = {SETTLING_TIME: "settles s", HOLD_OVERSHOOT: "overshoot %", FELT_STIFFNESS: "felt N/m"}
"""Additional measures in the tables of runs, and their column titles."""
MAX_FRONT_ROWS = 8
MAX_REASONS = 5
MAX_WORST_ROWS = 40
MAX_HEADLINE_VALUES = 3
"""Maximum number of parameter values of the best run in the headline; with more, they are only in the table."""
BIN_SHADES = " .:-=+*#"
HISTOGRAM_TITLE = "least to most"
SENSITIVITY_KEYS = ("correlation", "indices")
"""Keys of the parts that the text has with `--sensitivity` only; JSON and page always have them."""


@dataclass(frozen=True)
class ReportPart:
    """A titled table, which may be empty, with remarks, the sentences below it.

    Attributes:
        notes: text of a first cell -> explanation, shown only on a page, where there is room.
        text_only: titles of columns that a page leaves out, because it has a picture.
    """

    key: str
    title: str
    head: Sequence[str]
    rows: Sequence[Sequence[str]]
    remarks: Sequence[str] = ()
    notes: Mapping[str, str] = field(default_factory=dict)
    text_only: Sequence[str] = ()


def short_names(labels: Sequence[str]) -> dict[str, str]:
    """Shorten each label to its last parts that distinguish it from the others; a number is never the whole name."""
    names = {}
    for label in labels:
        parts = label.split(".")
        for count in range(2 if parts[-1].isdigit() else 1, len(parts) + 1):
            name = ".".join(parts[-count:])
            if sum(other == name or other.endswith(f".{name}") for other in labels) == 1:
                break
        names[label] = name
    return names


def number(value: float, digits: int = 4) -> str:
    """Format a rounded number; `-` for NaN, `never` for infinity."""
    if math.isnan(value):
        return "-"
    if math.isinf(value):
        return "never"
    return "0" if abs(value) < 1e-12 else f"{value:.{digits}g}"


def interval(ends: sensitivity.Interval, form: str = ".2f") -> str:
    """Format an interval, `0.12 .. 0.34`; `-` without one, or if an end is NaN."""
    low, high = ends or (math.nan, math.nan)
    return "-" if math.isnan(low) or math.isnan(high) else f"{low:{form}} .. {high:{form}}"


def parameter_text(sweep: SweepRows, label: str, row: int) -> str:
    """Format the value of a parameter in a row; `-` if the run does not have it."""
    parameters = sweep.columns.by_name.get(f"parameters/{label}")
    parameter = None if parameters is None else parameters[row]
    if parameter is None or parameter != parameter:
        return "-"
    return f"{parameter:.4g}" if isinstance(parameter, float) else str(parameter)


def claims_sentence(found: Sequence[ranking.Likelihood]) -> str:
    """Summarise the claims: `17 of 20 claims hold in at least 95 % of the runs; least sure: F_z stays lower (41 %)`."""
    judged = [one for one in found if one.judged]
    if not judged:
        return "no claim could be judged"
    likely = sum(one.share >= LIKELY_SHARE for one in judged)
    least = min(judged, key=lambda one: one.share)
    text = f"{likely} of {len(judged)} claims hold in at least {100 * LIKELY_SHARE:g} % of the runs"
    return text if least.share >= LIKELY_SHARE else f"{text}; least sure: {least.claim.key} ({100 * least.share:.0f} %)"


def claims_part(sweep: SweepRows) -> ReportPart | None:
    """Return the table of claims with their probabilities; None if the sweep judges no claims."""
    found = ranking.likelihoods(sweep.columns)
    if not found:
        return None
    head = ["claim", "holds in", "P, 95 %", "expected", "median", "5 to 95 %"]
    lines = [
        [
            one.claim.key,
            f"{one.holds} of {one.judged}",
            interval(one.interval) if one.judged else "-",
            f"{one.claim.bounds_text} {one.claim.unit}".rstrip(),
            _quantile_text(one, MEDIAN_INDEX),
            f"{_quantile_text(one, 0)} .. {_quantile_text(one, -1)}",
        ]
        for one in found
    ]
    columns = sweep.columns
    verdicts = (columns.categorical(name) for name in columns.names_in_group("verdicts").values())
    judged = int(np.any([one.mask(lambda verdict: verdict is not None) for one in verdicts], axis=0).sum())
    remarks = ["P: Wilson interval. true_...: twin's own claims, on the true force"]
    if missing := len(columns) - judged:
        remarks.append(f"{missing} of {len(columns)} runs did not end and are not judged: reasons below")
    remarks += [f"{one.claim.key}: trivial in {one.trivial} runs, not counted" for one in found if one.trivial]
    notes = {one.claim.key: one.claim.text for one in found}
    return ReportPart("claims", f"claims of Fig. 4 over {judged} runs", head, lines, remarks, notes)


def _quantile_text(one: ranking.Likelihood, quantile: int) -> str:
    value = one.quantiles[quantile]
    return number(value) if not math.isfinite(value) else f"{value:.{one.claim.digits}f}"


def sensitivity_parts(sweep: SweepRows, metric: str) -> list[ReportPart]:
    """Return the sensitivity tables of each drive; sensitivities of one drive need not apply to another."""
    found: list[ReportPart | None] = []
    drives = ranking.drives_in(sweep.columns)
    for drive in drives:
        columns = sweep.columns if len(drives) == 1 else sweep.columns.select(ranking.drive_mask(sweep.columns, drive))
        of = f", {drive}" if len(drives) > 1 else ""
        found += [_correlations(sweep, columns, metric, of), _indices(sweep, columns, metric, of)]
    parts = [part for part in found if part is not None]
    if parts and (why := sensitivity.why_no_indices(sweep.design)):
        parts[-1] = replace(parts[-1], remarks=[*parts[-1].remarks, why])
    return parts


def significant_parameters(correlations: dict[str, sensitivity.Correlation]) -> set[str]:
    """Return the parameters with a significant correlation at `FAMILYWISE_LEVEL`, by Holm (1979)."""
    stars: set[str] = set()
    ordered = sorted(correlations.items(), key=lambda item: item[1].p)
    for tested, (label, found) in enumerate(ordered):
        if found.p > FAMILYWISE_LEVEL / (len(ordered) - tested):
            break
        stars.add(label)
    return stars


def _correlations(sweep: SweepRows, columns: Columns, metric: str, of: str) -> ReportPart | None:
    names = short_names(sweep.labels)
    found = {
        label: correlation
        for label in ranking.numeric_labels(sweep.labels, columns)
        if (correlation := sensitivity.rank_correlation(columns, label, metric))
    }
    if not found:
        return None
    stars = significant_parameters(found)
    lines = [
        [
            names[label],
            f"{one.rho:+.2f}{'*' if label in stars else ' '}",
            interval((one.low, one.high), "+.2f"),
            f"{one.p:.2g}",
        ]
        for label, one in sorted(found.items(), key=lambda item: -abs(item[1].rho))
    ]
    remarks = [f"* not by chance: 5 % for {count_text(len(found), 'parameter')} together (Holm)"]
    fewest = min(one.runs for one in found.values())
    if fewest < sensitivity.RELIABLE_RUNS:
        remarks.append(f"only {fewest} runs: intervals are wide, and parameters without a star may matter too")
    title = f"rank correlation with {metric}{of} (Spearman: + rises with the parameter)"
    return ReportPart("correlation", title, ["parameter", "rho ", "95 %", "p"], lines, remarks)


def _indices(sweep: SweepRows, columns: Columns, metric: str, of: str) -> ReportPart | None:
    if sweep.design != "saltelli":
        return None
    found = sensitivity.sobol_indices(columns, sweep.labels, sweep.runs // max(1, len(sweep.drives)), metric)
    title = f"Sobol indices of {metric}{of}, {found.blocks} of {found.planned} blocks"
    remarks = [found.remark] if found.remark else []
    if not found.entries:
        return ReportPart("indices", title, [], [], remarks)
    names = short_names(sweep.labels)
    lines = [
        [names[one.label], f"{one.first:.2f}", interval(one.first_interval), f"{one.total:.2f}",
         interval(one.total_interval)]
        for one in sorted(found.entries, key=lambda one: -one.total)
    ]  # fmt: skip
    ranges = [some for one in found.entries for some in (one.first_interval, one.total_interval) if some]
    if ranges:
        remarks.append(f"95 %: {COVERAGE_NOTE}")
    elif found.blocks < sensitivity.MIN_INTERVAL_BLOCKS:
        remarks.append(
            f"no intervals: with fewer than {sensitivity.MIN_INTERVAL_BLOCKS} blocks they cover much less than stated"
        )
    if max((high - low for low, high in ranges), default=0.0) > WIDE_INTERVAL:
        remarks.append("some intervals are wide: four times the blocks make them half as wide")
    remarks.append("first: share of the variance that it explains alone; total: together with others")
    return ReportPart("indices", title, ["parameter", "first", "95 %", "total", "95 %"], lines, remarks)


@dataclass(frozen=True)
class SweepQuery:
    """A query for the report of a sweep, ranked `by` a metric; `against`: the other one of the Pareto front.

    Attributes:
        worst_over: parameter over which every choice of the other parameters is judged by its worst run; None to skip.
    """

    by: str
    against: str
    top: int
    worst_over: str | None = None


def parts(sweep: SweepRows, asked: SweepQuery) -> list[ReportPart]:
    """Return all parts, most important first; with claims no best run, as uncertain values cannot be chosen."""
    judged = claims_part(sweep)
    found: list[ReportPart | None] = [judged] if judged else [f(sweep, asked) for f in (_best, _margins, _drives)]
    if asked.worst_over is not None:
        found.insert(0, _worst(sweep, asked, asked.worst_over))
    found += sensitivity_parts(sweep, asked.by)
    if not judged:
        found.append(_front(sweep, asked))
    found += [_distributions(sweep), _reasons(sweep)]
    return [part for part in found if part is not None]


def headline(sweep: SweepRows, by: str) -> str:
    """Return the first sentence, such as `NAME  20 runs: smallest hold_error_N 0.031 (run 4: kp = 0.5); 2 failed`."""
    columns = sweep.columns
    begun = "" if len(columns) == sweep.runs else f"{len(columns)} of "
    text = f"{sweep.name}  {begun}{count_text(sweep.runs, 'run')}"
    ranked = ranking.ranked_rows(columns, by)
    if found := ranking.likelihoods(columns):
        text += f": {claims_sentence(found)}"
    elif len(ranked):
        best_run = f"run {columns.run_number(ranked[0])}{_varied_values(sweep, ranked[0])}"
        text += f": smallest {by} {number(value(columns, by)[ranked[0]], 3)} ({best_run})"
        if equal := len(ranking.equal_to_best(columns, by)):
            floor = ranking.floor_text(by)
            text += f", equal to {count_text(equal, 'other')}" + (f" within {floor}" if floor else "")
        names = short_names(sweep.labels)
        if edges := [names[label] for label in ranking.at_edges(columns, sweep.labels, ranked[0])]:
            text += f"; {', '.join(edges)} at the edge of the range tried"
        if by == SINCE_TOUCH and np.isnan(value(columns, HOLD_ERROR)).all():
            text += "; this is the error since the first touch, as no run has a hold error"
    elif len(columns):
        text += ": none with " + by + (" keeps the limits" if sweep.limits else "")
    statuses = columns.categorical("status").counts
    counts = [f"{count} {status}" for status, count in sorted(statuses.items()) if status != "done"]
    if sweep.limits:
        counts.append(f"{columns.categorical('within_limits').counts.get(True, 0)} within limits")
    return text + "".join(f"; {one}" for one in counts)


def _varied_values(sweep: SweepRows, row: int) -> str:
    """Format the varied values of a run, `: k_s_Nm_per_rad = 1.5, kp = 2`; "" if there are too many for a headline."""
    names = short_names(sweep.labels)
    found = [f"{names[label]} = {parameter_text(sweep, label, row)}" for label in sweep.labels]
    if len(sweep.drives) > 1:
        found.append(f"drive {sweep.columns.categorical('drive')[row] or '-'}")
    return f": {', '.join(found)}" if 0 < len(found) <= MAX_HEADLINE_VALUES else ""


def _best(sweep: SweepRows, asked: SweepQuery) -> ReportPart | None:
    rows = best_rows(sweep, asked)
    if not len(rows):
        return None
    columns, equal = sweep.columns, ranking.equal_to_best(sweep.columns, asked.by)
    head, cells = _runs(sweep, rows, asked)
    remarks = []
    if len(equal):
        for row in cells[1 : 1 + len(equal)]:
            row[0] = f"={row[0]}"
        floor = ranking.floor_text(asked.by)
        within = f" within {floor}" if floor else ""
        rest = f" ({len(equal) - len(rows) + 1} more not shown)" if len(equal) >= len(rows) else ""
        order = [
            name
            for metric, name in ((SETTLING_TIME, "settling time"), (HOLD_OVERSHOOT, "overshoot"), (asked.by, asked.by))
            if not np.isnan(value(columns, metric)).all()
        ]
        remarks.append(f"=: equal to the best{within}{rest}; ordered by {', then '.join(order[:2])}")
    missing = columns.categorical("status").mask(lambda status: status == "done") & np.isnan(value(columns, asked.by))
    reasons = (
        [why for why in columns.categorical("no_hold").select(missing).counts if why] if asked.by == HOLD_ERROR else []
    )
    if missing.any() and asked.by != "chatter_N":
        why = f": {'; '.join(reasons)}" if reasons else ""
        remarks.append(f"{count_text(int(missing.sum()), 'run')} without {asked.by}{why}")
    remarks += [
        f"{title}, -: {BY_COLUMN[metric].missing}"
        for metric, title in COMPANION_TITLES.items()
        if title in head and any(row[head.index(title)] == "-" for row in cells)
    ]
    return ReportPart("best", f"best runs by {asked.by}", head, cells, remarks)


def best_rows(sweep: SweepRows, asked: SweepQuery) -> Positions:
    """Return the rows of the runs to show: the best run, its equals, then the next best."""
    ranked, equal = (find(sweep.columns, asked.by) for find in (ranking.ranked_rows, ranking.equal_to_best))
    others = ranked[1:][~np.isin(ranked[1:], equal)]
    shown = max(asked.top, min(MAX_EQUAL_ROWS, 1 + len(equal)))
    return np.concatenate([ranked[:1], equal, others])[:shown]


def _margins(sweep: SweepRows, asked: SweepQuery) -> ReportPart | None:
    """Return the table of force loop margins of the best runs; None if they were not computed."""
    keys = sweep.columns.categorical("key").select(best_rows(sweep, asked))
    found = [sweep.margins[key] for key in keys if key in sweep.margins]
    if not found:
        return None
    rows = [
        [str(one["run"]), _margin_text(one["gain"]), _margin_text(one["phase_rad"], 180.0 / math.pi)]
        for one in found
        if not one["reason"]
    ]
    reasons = Counter(one["reason"] for one in found if one["reason"])
    remarks = [f"none of {count_text(runs, 'run')}: {terminal_text(reason)}" for reason, runs in reasons.items()]
    if any("-" in row for row in rows):
        remarks.append("-: no gain up to 1000, or no change of phase, makes the loop unstable")
    title = "margins of the force loop where it presses, linear model; other loops: twin analyse"
    return ReportPart("margins", title, ["run", "gain", "phase deg"] if rows else [], rows, remarks)


def _margin_text(found: float | None, factor: float = 1.0) -> str:
    return "-" if found is None else number(factor * found, 3)


def _worst(sweep: SweepRows, asked: SweepQuery, label: str) -> ReportPart:
    columns, names = sweep.columns, short_names(sweep.labels)
    found = worst_over(columns, asked.by, label, sweep.labels)
    others = [other for other in sweep.labels if other != label]
    several = len(sweep.drives) > 1
    rows = [
        [
            *(parameter_text(sweep, other, one.row) for other in others),
            *([columns.categorical("drive")[one.row] or ""] if several else []),
            "failed" if math.isinf(one.metric) else number(one.metric),
            parameter_text(sweep, label, one.row),
            str(one.runs),
            str(one.bad) if one.bad else "-",
        ]
        for one in found[:MAX_WORST_ROWS]
    ]
    head = [*(names[other] for other in others), *(["drive"] if several else [])]
    head += [f"worst {asked.by}", f"at {names[label]}", "runs", "failed"]
    remarks = ["failed: also tripped, beyond a limit, or without that number; it counts as worst"]
    if len(found) > MAX_WORST_ROWS:
        remarks.append(f"and {len(found) - MAX_WORST_ROWS} more")
    if found and max(one.runs for one in found) == 1:
        remarks.append(f"each choice has one run: {names[label]} does not vary by itself, as it does in a grid")
    return ReportPart("worst", f"worst {asked.by} over {names[label]}, least worst first", head, rows, remarks)


def _front(sweep: SweepRows, asked: SweepQuery) -> ReportPart | None:
    front = ranking.pareto_front(sweep.columns, asked.by, asked.against)
    if not len(front) or asked.by == asked.against:
        return None
    head, rows = _runs(sweep, front[:MAX_FRONT_ROWS], asked)
    more = [f"and {len(front) - MAX_FRONT_ROWS} more"] if len(front) > MAX_FRONT_ROWS else []
    ranked = len(ranking.ranked_rows(sweep.columns, asked.by))
    title = f"Pareto front of {asked.by} and {asked.against}: {count_text(len(front), 'run')} of {ranked}"
    return ReportPart("front", title, head, rows, more)


def _runs(sweep: SweepRows, rows: Positions, asked: SweepQuery) -> tuple[list[str], list[list[str]]]:
    columns, names = sweep.columns, short_names(sweep.labels)
    metrics = [m for m in dict.fromkeys((asked.by, asked.against)) if m == asked.by or m not in COMPANION_TITLES]
    beside = [m for m in COMPANION_TITLES if m != asked.by and not np.isnan(value(columns, m)).all()]
    several = len(sweep.drives) > 1
    head = ["run", *metrics, *(["drive"] if several else []), *(names[label] for label in sweep.labels)]
    return [*head, *(COMPANION_TITLES[metric] for metric in beside)], [
        [
            str(columns.run_number(row)),
            *(number(value(columns, metric)[row]) for metric in metrics),
            *([columns.categorical("drive")[row] or ""] if several else []),
            *(parameter_text(sweep, label, row) for label in sweep.labels),
            *(number(value(columns, metric)[row]) for metric in beside),
        ]
        for row in rows
    ]


def _drives(sweep: SweepRows, asked: SweepQuery) -> ReportPart | None:
    if len(ranking.drives_in(sweep.columns)) < 2:
        return None
    scores = ranking.drive_ranking(sweep.columns, asked.by)
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
    floor, floor_text = ranking.floor(asked.by, np.array(leader.median)), ranking.floor_text(asked.by)
    tied = [
        score.drive
        for score in others
        if not math.isnan(score.behind) and (not score.distinguishable or abs(score.behind) <= floor)
    ]
    remarks = ["behind: median difference to the first, point by point; first, P: chance to rank first, both resampled"]
    if tied:
        beyond = f", by an interval without 0 and more than {floor_text}" if floor_text else ""
        remarks.append(f"not distinguished from {leader.drive}{beyond}: {', '.join(tied)}")
    return ReportPart("drives", f"drives by {asked.by}", head, rows, remarks)


def _distributions(sweep: SweepRows) -> ReportPart | None:
    spreads = [
        found for metric in ranking.metrics_in(sweep.columns) if (found := ranking.metric_spread(sweep.columns, metric))
    ]
    if not spreads or len(sweep.columns) < 2:
        return None
    head = ["metric", *(f"{100 * share:g} %" for share in ranking.QUANTILES), HISTOGRAM_TITLE, "missing"]
    rows = [
        [
            one.metric,
            *map(number, one.quantiles),
            f"|{_histogram(one.counts):{HISTOGRAM_BINS}}|",
            str(one.missing) if one.missing else "-",
        ]
        for one in spreads
    ]
    return ReportPart("metrics", "each metric over all runs, quantiles", head, rows, text_only=(HISTOGRAM_TITLE,))


def _histogram(counts: Sequence[int]) -> str:
    return "".join(BIN_SHADES[math.ceil(n / max(counts) * (len(BIN_SHADES) - 1))] for n in counts)


def _reasons(sweep: SweepRows) -> ReportPart | None:
    reasons: dict[tuple[str, str], list[int]] = {}
    columns = sweep.columns
    rows = columns.categorical("status").mask(lambda status: status != "done")
    words = [columns.categorical(name).select(rows) for name in ("status", "reason")]
    for run, status, reason in zip(columns.numbers("run")[rows], *words, strict=True):
        reasons.setdefault((status, "".join(reason.splitlines()[:1])), []).append(int(run))
    if not reasons:
        return None
    most_first = sorted(reasons.items(), key=lambda item: -len(item[1]))
    lines = []
    for (status, reason), runs in most_first[:MAX_REASONS]:
        others = f" and {count_text(len(runs) - 1, 'other')}" if len(runs) > 1 else ""
        lines.append(terminal_text(f"run {runs[0]}{others} {status}: {reason}"))
    if len(reasons) > MAX_REASONS:
        lines.append(f"{len(reasons) - MAX_REASONS} other reasons are in the rows")
    return ReportPart("reasons", "runs that are not done", [], [], lines)


def axes_of(sweep: SweepRows, x: str | None, y: str | None) -> tuple[str, str] | None:
    """Return the two parameters of the map: the requested ones, else the first numeric; None if fewer than two."""
    numeric = ranking.numeric_labels(sweep.labels, sweep.columns)
    names = short_names(sweep.labels)
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


def worst_label(sweep: SweepRows, wanted: str | None) -> str | None:
    """Return the full label of the `--worst-over` parameter, given by its full or short name."""
    names = short_names(sweep.labels)
    found = next((label for label in sweep.labels if wanted in (label, names[label])), None)
    if wanted is not None and found is None:
        raise InputRefused(f"--worst-over {wanted}: does not vary here; {nearest(wanted, sweep.labels)}")
    return found


def sweep_text(sweep: SweepRows, asked: SweepQuery, sensitivity: bool = False) -> str:
    found = parts(sweep, asked)
    shown = [part for part in found if sensitivity or part.key not in SENSITIVITY_KEYS]
    more = ["", "rank correlations and Sobol indices: --sensitivity"] if len(shown) < len(found) else []
    return lay_out([_fold(headline(sweep, asked.by)), *(block for part in shown for block in _blocks(part)), *more])


def _blocks(part: ReportPart) -> list[Block]:
    columns = [Column(title, left=number == 0, gap=2) for number, title in enumerate(part.head)]
    table: list[Block] = [Table(columns, part.rows, left_out="--html")] if part.rows else []
    return ["", _fold(part.title), *table, *(Note(remark, "  ", 4, whole=True) for remark in part.remarks)]


def headline_text(sweep: SweepRows, by: str) -> str:
    return lay_out([_fold(headline(sweep, by))])


def _fold(text: str) -> Note:
    return Note(text, later=2, whole=True)
