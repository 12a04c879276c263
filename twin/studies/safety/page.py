"""HTML page of a hazard table: one printable file, from hazard to run."""

import base64
import math
from collections.abc import Iterator, Sequence
from html import escape
from pathlib import Path

from twin.robot.experiment.fault import FAULT_KINDS
from twin.studies.faults.reaction import BEARABLE_FORCE, Reaction
from twin.studies.faults.text import magnitude_text
from twin.studies.faults.together import slowest
from twin.studies.safety.evidence import CONFIDENCE_LEVEL, EvidenceRun, HazardLine, interval
from twin.studies.safety.hazards import Hazard, SafetyTable

SIMULATION_NOTICE = (
    "This page complies with no standard by itself. It was written by a simulation: no part of it was measured on the "
    "robot or on a person. It has the structure of ISO 14971 so that a reviewer finds what such a review needs."
)
REVIEWER_TASKS = (
    "Check that the hazards are complete: this table knows only those that somebody wrote into it.",
    "Judge severity and probability: faults have no rates here, only consequences.",
    "Replace what is assumed by measurements: drives without power, bodies, head, thresholds of pain.",
    "Repeat the worst run of each line with the command given, and compare its digest.",
    "Measure force and pressure on the robot itself with the worst faults, under a person's stand-in.",
    "Decide whether what is left of each risk is acceptable, and sign for it.",
)
PAGE_STYLE = """
body{font:14px/1.45 system-ui,sans-serif;color:#1c1c1c;max-width:62rem;margin:1.5rem auto;padding:0 1rem}
h1{font-size:1.5rem}h2{font-size:1.15rem;margin-top:2rem;border-top:2px solid #1c1c1c;padding-top:.6rem}
table{border-collapse:collapse;width:100%;margin:.6rem 0}
th,td{border:1px solid #bbb;padding:.25rem .45rem;text-align:left;vertical-align:top}
th{background:#f3f3f3}td.n{text-align:right;font-variant-numeric:tabular-nums}
.notice{border:2px solid #c62828;padding:.6rem .8rem;font-weight:600}
.kept{color:#1b5e20;font-weight:700}.exceeded,.failed{color:#c62828;font-weight:700}.stated{color:#a15c00;font-weight:700}
.runs table{font-size:.66rem}.runs td,.runs th{padding:.1rem .25rem}.runs td code{font-size:.6rem;white-space:nowrap}
code{font-size:.8rem;overflow-wrap:anywhere}img{max-width:100%}details{margin:.5rem 0}
@media screen and (max-width:62rem){table{display:block;overflow-x:auto}}
@media print{body{max-width:none;margin:0}h2{break-after:avoid}tr,img{break-inside:avoid}details>*{display:block}
img{max-height:24cm}.runs table,.runs td code{font-size:.5rem}.runs td,.runs th{padding:.05rem .12rem}}
"""
OVERVIEW_HEAD = ("", "hazard", "limit", "worst", "ideal monitor", "without monitor", "seen", "status")
MIN_PUBLISHED = 2
SECURITY_POLICY = "default-src 'none'; style-src 'unsafe-inline'; img-src data:"
STATUS_CLASSES = {
    "kept": "kept", "kept unseen": "stated", "exceeded": "exceeded", "exceeded as stated": "stated", "failed": "failed",
}  # fmt: skip


def hazard_page(
    table: SafetyTable, lines: Sequence[HazardLine], pictures: Sequence[tuple[str, Path]], made_with: str
) -> str:
    """Create the whole page of a hazard table as HTML, with the pictures (title, file) embedded."""
    return "\n".join(
        [
            "<!doctype html>",
            '<html lang="en"><head><meta charset="utf-8">',
            '<meta name="viewport" content="width=device-width, initial-scale=1">',
            f'<meta http-equiv="Content-Security-Policy" content="{SECURITY_POLICY}">',
            f"<title>{escape(table.head.title)}: hazards</title>",
            f"<style>{PAGE_STYLE}</style></head><body>",
            f"<h1>{escape(table.head.title)}: hazards and the runs behind them</h1>",
            f'<p class="notice">{escape(SIMULATION_NOTICE)}</p>',
            f"<p><b>Intended use</b>: {escape(table.head.use)}</p>",
            f"<p><code>{escape(made_with)}</code></p>",
            "<h2>What a reviewer still has to do</h2>",
            "<ol>" + "".join(f"<li>{escape(task)}</li>" for task in REVIEWER_TASKS) + "</ol>",
            "<h2>All lines</h2>",
            _table(OVERVIEW_HEAD, [list(_summary(line)) for line in lines]),
            *(_picture(title, path) for title, path in pictures),
            *(part for line in lines for part in _line(table, line)),
            "</body></html>",
        ]
    )


def _table(head: Sequence[str], rows: Sequence[Sequence[str]]) -> str:
    """Format an HTML table from a head and cells of HTML; numbers are right-aligned."""
    top = "".join(f"<th>{escape(cell)}</th>" for cell in head)
    body = "".join("<tr>" + "".join(_cell(cell) for cell in row) + "</tr>" for row in rows)
    row = f"<tr>{top}</tr>" if any(head) else ""
    return f"<table>{row}{body}</table>"


def _cell(text: str) -> str:
    plain = text.replace("-", "").replace(".", "").replace("%", "").strip()
    return f'<td class="n">{text}</td>' if plain.isdigit() or text == "-" else f"<td>{text}</td>"


def _picture(title: str, path: Path) -> str:
    data = base64.b64encode(path.read_bytes()).decode()
    return f'<h2>{escape(title)}</h2><img alt="{escape(title)}" src="data:image/png;base64,{data}">'


def _status(line: HazardLine) -> str:
    return f'<span class="{STATUS_CLASSES[line.status]}">{line.status}</span>'


def _summary(line: HazardLine) -> Iterator[str]:
    yield f'<a href="#{escape(line.hazard.table.id)}">{escape(line.hazard.table.id)}</a>'
    yield escape(line.hazard.table.hazard)
    yield escape(line.hazard.limit_text)
    yield from worst_texts(line)
    yield seen_text(line)
    yield _status(line)


def magnitude_ranges(hazards: Sequence[Hazard]) -> list[str]:
    """Format the range of each fault kind's magnitudes in grid, search and draws: `drive_runaway 0.5 to 8 rad/s`."""
    ranges: dict[str, tuple[float, float]] = {}
    for cause in (cause for hazard in hazards for cause in hazard.causes):
        for number, (kind, _) in enumerate(cause.faults):
            if known := FAULT_KINDS[kind].magnitudes:
                smallest = slowest(kind, cause.ordered and number == 1) or ranges.get(kind, known)[0]
                ranges[kind] = smallest, known[-1]
    return [f"{kind} {smallest:g} to {magnitude_text(kind, largest)}" for kind, (smallest, largest) in ranges.items()]


def seen_text(line: HazardLine) -> str:
    """Format the number of detected runs of a hazard line."""
    seen, made = line.detection
    return f"{seen} of {made}" if made else "-"


def worst_texts(line: HazardLine) -> list[str]:
    """Format the limited quantity of the line's worst run: with the monitor, with an ideal one, and without."""
    worst, unit = line.worst, line.hazard.limit_key.rpartition("_")[2]
    runs = (worst.watched, worst.ideal, worst.unwatched) if worst else (None,) * 3
    values = [None if run is None else line.limited_value(run) for run in runs]
    return ["-" if v is None else "to the end" if math.isinf(v) else f"{v:.3g} {unit}" for v in values]


def _line(table: SafetyTable, line: HazardLine) -> Iterator[str]:
    words, worst = line.hazard.table, line.worst
    yield f'<h2 id="{escape(words.id)}">{escape(words.id)}: {escape(words.hazard)} - {_status(line)}</h2>'
    facts = [
        ("harm", words.harm),
        ("severity", words.severity),
        ("causes", "; ".join(map(str, line.hazard.causes))),
        ("magnitudes", "; ".join(magnitude_ranges([line.hazard])) or "none"),
        ("limit", line.hazard.limit_text),
        ("control measure", words.control),
        ("residual risk", words.residual),
        *([("beyond the limit because", words.beyond)] if words.beyond else []),
    ]
    yield _table(("", ""), [(f"<b>{name}</b>", escape(text)) for name, text in facts])
    for name, left in line.distances.items():
        outcome = "kept" if left >= 0.0 else "violated"
        yield f"<p><code>{escape(name)}</code>: {outcome}, distance {left:.3g} (SI)</p>"
    for run in line.failed_runs:
        yield f'<p class="failed">failed: {escape(run.cause)} on {escape(run.body)}: {escape(run.failure)}</p>'
    if worst and worst.watched:
        yield from _worst(table, line, worst, worst.watched)
    yield from _runs(line)


def _worst(table: SafetyTable, line: HazardLine, worst: EvidenceRun, run: Reaction) -> Iterator[str]:
    how = (
        f"{line.search_count} more runs searched for a worse one found none"
        if worst.found == "grid"
        else f"found by {'the search' if worst.found == 'search' else 'a draw'}, {line.search_count} runs of search"
    )
    yield f"<h3>Worst run: {escape(worst.cause)} on {escape(worst.body)} ({how})</h3>"
    named = {
        "seen (s)": lambda one: one.seen,
        "reaction at the drives (s)": lambda one: one.acted,
        "power off (s)": lambda one: one.power_off,
        f"below {BEARABLE_FORCE:g} N for good (s)": lambda one: "not by the end" if one.below is None else one.below,
        "peak (N)": lambda one: one.peak,
        "left at the end (N)": lambda one: one.left,
        "impulse (N s)": lambda one: one.impulse,
        "energy given to the body (J)": lambda one: one.energy,
        "pressure over the head (kPa)": lambda one: _pressure(line, one),
    }
    # an ideal monitor sees when this one does, and cuts all power at once
    runs = (run, worst.ideal, worst.unwatched)
    rows = [(name, *("-" if one is None else _number(value(one)) for one in runs)) for name, value in named.items()]
    yield _table(("from the onset on", "with monitor", "ideal: all power cut when seen", "without"), rows)
    if worst.unwatched is not None and worst.unwatched.failure:
        yield f"<p>Without the monitor the run ends early: {escape(worst.unwatched.failure)}</p>"
    pressure = _pressure(line, run)
    against = []
    for one in table.thresholds:
        level, unit, value = (one.pressure, "kPa", pressure) if one.pressure else (one.force or 1.0, "N", run.peak)
        against.append((escape(one.name), f"{level:g} {unit}", f"{100 * value / level:.0f} %", escape(one.source)))
    if against:
        yield _table(("pain begins at", "threshold", "this run", "source"), against)
    published = sum(t.has_publication for t in table.thresholds)
    if published < MIN_PUBLISHED:
        yield f"<p>Pain: {published} published thresholds, fewer than {MIN_PUBLISHED}: taken as assumed.</p>"
    if line.variants:
        others = [
            (escape(v.name), _pair(line.variants.get(v.name), 0), _pair(line.variants.get(v.name), 1), escape(v.why))
            for v in table.variants
        ]
        yield _table(("other hardware", "peak (N)", "left (N)", ""), others)
    yield f"<p>Again: <code>{escape(worst.command(table.head.experiment))}</code></p>"
    yield f"<p>run <code>{worst.id}</code>, seed {worst.seed}, digest of the force <code>{run.digest}</code></p>"


def _pair(found: tuple[float, float] | None, index: int) -> str:
    return "failed" if found is None else f"{found[index]:.1f}"


def _pressure(line: HazardLine, run: Reaction) -> float:
    """Compute the mean pressure over the head at the peak force of a run (kPa)."""
    return 1e-3 * run.peak / line.head_area


def _number(value: float | str | None) -> str:
    return "-" if value is None else value if isinstance(value, str) else f"{value:.3g}"


def share_text(share: tuple[int, int]) -> str:
    """Format a share with its confidence interval: `38 of 40 (95 % interval 83 to 99 %)`."""
    low, high = interval(share)
    return f"{share[0]} of {share[1]} ({100 * CONFIDENCE_LEVEL:.0f} % interval {100 * low:.0f} to {100 * high:.0f} %)"


def _dangerous(line: HazardLine) -> str:
    if not line.dangerous_count[1]:
        return "None of them exceeds the limit without the monitor."
    share = share_text(line.dangerous_count)
    return f"Of those that exceed the limit, or fail, without the monitor it keeps {share} below it."


def _runs(line: HazardLine) -> Iterator[str]:
    seen, made = line.grid_detection
    grid = f"Seen: {seen} of {made} runs of the grid, which chance did not choose."
    if line.draw_detection[1]:
        evidence = line.hazard.evidence
        yield (
            f"<p>Drawn at random (seed {evidence.seed}): {share_text(line.draw_detection)} seen. Cause, body, time and "
            f"place within {1e3 * evidence.reach:g} mm evenly, magnitudes evenly by ratio, from ones on that need no "
            f"detection. {_dangerous(line)} {grid}</p>"
        )
    elif made:
        yield f"<p>{grid} None was drawn, so no interval.</p>"
    head = (
        "run",
        "cause",
        "body",
        "from",
        "moved (mm)",
        "magnitudes",
        "onset (s)",
        "seed",
        "peak (N)",
        "left (N)",
        "seen (s)",
        "by",
        "digest",
    )
    rows = []
    for run in line.runs:
        sizes = ", ".join(f"{v:g}" for one in run.tables for k, v in one.items() if k.startswith("magnitude"))
        onset = f"{run.tables[0]['onset_s']:g}" if run.tables else ""
        cells: tuple[str, ...] = ("failed", "", "", escape(run.failure), "")
        if one := run.watched:
            digest = f"<code>{one.digest}</code>"
            cells = (f"{one.peak:.1f}", f"{one.left:.1f}", _number(one.seen), one.reason or "-", digest)
        where = "; ".join(text.partition("=")[2].strip("[]") for text in run.settings if "point_mm" in text)
        made_by = (f"<code>{run.id}</code>", escape(run.cause), run.body, run.found, where)
        rows.append((*made_by, sizes, onset, str(run.seed), *cells))
    yield f"<details class='runs' open><summary>{len(line.runs)} runs</summary>{_table(head, rows)}</details>"
