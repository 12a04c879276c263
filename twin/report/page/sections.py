"""The sections of the page that are text, tables and a picture."""

import math
from collections.abc import Callable, Sequence
from typing import TYPE_CHECKING, NamedTuple

from twin.report.page.markup import Markup, element, joined, section, table
from twin.report.page.measures import Measure, key_measures, number
from twin.report.page.provenance import differences, drives, flat, parameters, provenance, timing
from twin.report.page.run import ReportRun
from twin.report.page.verdict import PageVerdict, RunGroup
from twin.studies.paper.claim import ClaimFinding
from twin.studies.paper.fig4 import standing, tally

if TYPE_CHECKING:
    from twin.studies.accuracy.budget import Budget

MARKS = {
    "holds": ("✓ holds", "good"),
    "fails": ("✗ fails", "bad"),
    "trivial": ("- trivial", ""),
    "not reproduced": ("- not reproduced", ""),
    "reproduced after all": ("✓ reproduced after all", "good"),
    "not scored": ("? not scored", ""),
}


MOST_BOXED = 4
"""Runs whose key numbers stand beside the verdict."""
FEW = 5
"""Claims that are shown at once even if all of them hold."""
LOOKS = {True: ("✓ ", "good"), False: ("✗ ", "bad"), None: ("", "plain")}


class Section(NamedTuple):
    """A section of the page, and what the list of contents calls it."""

    key: str
    title: str
    html: Markup


def sections(
    runs: Sequence[ReportRun], verdict: PageVerdict, picture: Markup | None, budgets: Sequence["Budget"] = ()
) -> list[Section]:
    """Everything after the replay; `budgets`: of each run, or none."""
    budget = _accuracies(runs, budgets) if budgets else None
    found = [
        ("numbers", "Claims and measures", numbers(runs, verdict)),
        ("figure", "Figure", picture),
        ("accuracy", "Accuracy budget", budget),
        ("events", "Events", _of_each(runs, events)),
        ("drives", "Drives and FMUs", _of_each(runs, drives)),
        ("parameters", "Parameters", _of_each(runs, _folded_parameters)),
        ("timing", "Timing", timing(runs)),
        ("provenance", "How to make this again", _of_each(runs, provenance)),
    ]
    return [Section(key, title, section(key, title, html)) for key, title, html in found if html is not None]


def _accuracies(runs: Sequence[ReportRun], budgets: Sequence["Budget"]) -> Markup | None:
    # few ask for it, and what runs experiments takes a while to load
    from twin.report.page.accuracy import accuracy

    own = {run.label: one for run, one in zip(runs, budgets, strict=True)}
    return _of_each(runs, lambda run: accuracy(own[run.label], run.label))


def verdict_section(runs: Sequence[ReportRun], verdict: PageVerdict) -> Markup:
    """The first section: the sentence, three numbers of each run, and the remarks. All other numbers come after the
    player, which stands beside it."""
    mark, look = LOOKS[verdict.good]
    parts = [element("p", f"{mark}{verdict.headline}", class_=f"headline {look}")]
    # of more runs the table of measures is the place
    parts += [_boxes(runs)] if len(runs) <= MOST_BOXED else []
    if verdict.remarks:
        parts.append(element("ul", *(element("li", text) for text in verdict.remarks), class_="remarks"))
    return section("verdict", "Verdict", *parts)


def _boxes(runs: Sequence[ReportRun]) -> Markup:
    """Three numbers of what truly happened, the same of each run, under its name if there are several."""
    groups = []
    for run, found in zip(runs, key_measures(runs), strict=True):
        boxes = [
            element("div", element("strong", number(m.true, m.unit)), element("span", m.short or m.text), class_="box")
            for m in found
        ]
        label = [element("span", run.label, class_="whose")] if len(runs) > 1 else []
        groups.append(element("div", *label, *boxes, class_="boxes"))
    return element("div", *groups, class_="runs")


def numbers(runs: Sequence[ReportRun], verdict: PageVerdict) -> Markup:
    """What stands behind the verdict: the claims, the measures, what differs between the runs."""
    parts = [_claims(group) for group in verdict.groups]
    parts += [element("h3", "Measures: what truly happened, and what the robot believed"), _measures(runs)]
    if len(runs) > 1:
        head = ("what differs", "unit", *(run.label for run in runs))
        rows = differences(runs)
        parts.append(element("h3", "Differences"))
        same = element("p", "Nothing in experiments, FMUs and versions.")
        parts.append(table(head, rows, "what differs between the runs") if rows else same)
    return joined(parts)


def events(run: ReportRun) -> Markup:
    """What happened when; a click on a time goes there. Phases of tasks, which are many, are folded away."""
    rows = {
        debug: [
            (element("button", f"{event.time:.3f} s", type="button", class_="at", data_t=f"{event.time:.9g}"),
             event.level, event.name, event.text)
            for event in run.recording.events if (event.level == "debug") == debug
        ]
        for debug in (False, True)
    }  # fmt: skip
    head = ("at", "level", "of", "what")
    parts = [table(head, rows[False], f"events of {run.label}") if rows[False] else element("p", "None.")]
    if rows[True]:
        inside = table(head, rows[True], f"phases of {run.label}")
        parts.append(element("details", element("summary", f"{len(rows[True])} phases"), inside))
    return joined(parts)


def _claims(group: RunGroup) -> Markup:
    held, judged = tally(group.findings)
    said = standing(group.findings).replace(" claims", "")
    rows = [_claim(finding) for finding in group.findings]
    head = ("claim", "verdict", "measured", "expected", "why")
    told = element("summary", f"{group.title}: {said}")
    unfolded = {"open": ""} if held < judged or len(rows) <= FEW else {}
    return element("details", told, table(head, rows, group.title), **unfolded)


def _claim(finding: ClaimFinding) -> tuple[str, ...]:
    claim = finding.claim
    text, look = MARKS[finding.verdict]
    place = f"Fig. {claim.figure}: " if claim.figure[0].isdigit() else ""
    quoted = element("small", f"{place}{claim.quote}")
    expected = f"{finding.expected} {claim.unit}".rstrip() if finding.expected else ""
    return (
        joined([claim.text, quoted]),
        element("span", text, class_=look),
        finding.measured,
        expected,
        finding.reason or claim.source,
    )


def _measures(runs: Sequence[ReportRun]) -> Markup:
    """A measure per line, a run per column."""
    found = [{(m.text, m.unit): m for m in run.measures} for run in runs]
    lines = dict.fromkeys(key for one in found for key in one)
    if len(runs) == 1:
        told = [(text, number(m.true), number(m.believed), unit) for (text, unit), m in found[0].items()]
        return table(("measure", "true", "believed", "unit"), told, "measures")
    rows = [(text, unit, *(_measure(one.get((text, unit))) for one in found)) for text, unit in lines]
    return table(("measure", "unit", *(run.label for run in runs)), rows, "measures")


def _measure(measure: Measure | None) -> Markup:
    if measure is None:
        return Markup("-")
    believed = [] if math.isnan(measure.believed) else [element("small", f"believed {number(measure.believed)}")]
    return joined([number(measure.true), *believed])


def _folded_parameters(run: ReportRun) -> Markup:
    count = sum(1 for _ in flat(run.values))
    return element("details", element("summary", f"{count} values with unit and source"), parameters(run))


def _of_each(runs: Sequence[ReportRun], told: Callable[[ReportRun], Markup]) -> Markup:
    """One run plainly, several under their names."""
    if len(runs) == 1:
        return told(runs[0])
    return joined([part for run in runs for part in (element("h3", run.label), told(run))])
