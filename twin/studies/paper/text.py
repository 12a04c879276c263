"""Claims beside measured values, as text of at most 80 columns: the verdict first."""

from collections.abc import Iterable, Mapping, Sequence

from twin.studies.lines import WIDTH, counted
from twin.studies.paper.claim import ClaimFinding
from twin.studies.paper.fig4 import Score, bound_used, standing, tally
from twin.studies.paper.fig5 import Fig5Score, TaskScore
from twin.studies.result import Block, Column, Note, Result, Row, Table

MARKS = {
    "holds": "ok", "fails": "FAIL", "trivial": "n/a", "not reproduced": "miss", "reproduced after all": "ok !",
    "not scored": "?",
}  # fmt: skip
FEW = 4
"""More runs than these become a table."""
KINDS = ("press", "tap", "roll", "push")


def fig4_result(score: Score) -> Result:
    """Fig. 4: the claims of the paper, then ours on the true force."""
    lines: list[Block] = []
    if score.unscored:
        lines += [f"Not scored: {counted(len(score.unscored), 'claim')}, marked ?, for want of what a run lacks:"]
        lines += [f"  {run}: no {', '.join(series)}" for run, series in score.missing.items()]
    lines += [_two("Fig. 4: force-position control", standing(score.claims)), _claims(score.claims)]
    if not score.without_x:
        lines += ["  Imperfect: scale tilted, encoders off zero. All other rows: the ideal runs."]
    lines += ["", "Judged on the true contact force, force-position run", _claims(score.quality)]
    if score.reproduced_after_all:
        lines += [f"'ok !': known not to be reproduced, and reproduced here: {', '.join(score.reproduced_after_all)}."]
    lines += ["", "Tuned to meet the text: " + ", ".join(sorted(key.rpartition(".")[2] for key in score.tuned))]
    lines += [f"Out of scope: {text}" for text in score.out_of_scope]
    return _result(lines, score.facts(), not score.failed and not score.unscored)


def fig5_result(score: Fig5Score) -> Result:
    """Fig. 5: every claim on every task of a few runs; of many runs a table, and what fails in them."""
    held, judged = tally(score.findings)
    lines: list[Block] = [_two("Fig. 5: pressing, tapping, rolling, pushing", f"{held} of {judged} claims hold")]
    runs = {task.run.recording.path for task in score.tasks}
    if len(runs) > FEW:
        lines += ["", *_table(score.tasks), "", *_failures(score.tasks), "", *score.remarks]
    else:
        lines += [*score.remarks, ""]
        for task in score.tasks:
            title = _two(f"{task.name}: {task.manner}", f"{task.drive} on {task.body}")
            lines += [title, _claims(task.findings), ""]
        lines += ["All are judged on the true force and the true position."]
    return _result(lines, score.facts(), not score.failed)


def _table(tasks: Sequence[TaskScore]) -> list[Block]:
    rows: dict[tuple[str, str], dict[str, list[ClaimFinding]]] = {}
    for task in tasks:
        rows.setdefault((task.drive, task.body), {}).setdefault(task.kind, []).extend(task.findings)
    cells = [[drive, body, *(_cell(kinds.get(kind, [])) for kind in KINDS)] for (drive, body), kinds in rows.items()]
    columns = [
        Column("drive", 18, ".18s", left=True),
        Column("body", 9, ".9s", left=True),
        *(Column(kind, 12) for kind in KINDS),
    ]
    return [
        Table(columns, cells, indent=0),
        "Claims held/judged, and how much of its bound the worst measure takes.",
    ]


def _cell(findings: Sequence[ClaimFinding]) -> str:
    held, judged = tally(findings)
    if not judged:
        return "-"
    worst = 100.0 * max(bound_used(finding) for finding in findings if finding.verdict in ("holds", "fails"))
    return f"{held}/{judged} {'>999' if worst > 999.0 else format(worst, '.0f')} %"


def _failures(tasks: Sequence[TaskScore]) -> list[str]:
    """What fails, one line per body, kind of task and claim: how often, the range measured, and with which drives."""
    drives = {task.drive for task in tasks}
    groups: dict[tuple[str, str, str], list[tuple[str, ClaimFinding]]] = {}
    for task in tasks:
        for finding in task.findings:
            if finding.verdict in ("holds", "fails"):
                groups.setdefault((task.body, task.kind, finding.claim.key), []).append((task.drive, finding))
    lines = []
    for (body, kind, key), judged in groups.items():
        failing = [(drive, finding) for drive, finding in judged if finding.verdict == "fails"]
        if failing:
            names = list(dict.fromkeys(drive for drive, _ in failing))
            who = "every drive" if len(names) == len(drives) else ", ".join(names)
            place = f"FAIL {body:8.8} {kind:5} {key:14} {len(failing):>2} of {len(judged):<2}"
            lines += [f"{place} {_range([finding for _, finding in failing]):>18} {failing[0][1].expected:>11}"]
            lines += [f"       {who}"]
    return lines


def _range(findings: Sequence[ClaimFinding]) -> str:
    """The least and the largest that was measured; `never` counts as larger."""
    least, *_, largest = [*(ordered := sorted(findings, key=lambda f: f.value)), ordered[-1]]
    if least.measured == largest.measured:
        return least.measured
    return f"{least.measured.removesuffix(least.claim.unit).rstrip()} .. {largest.measured}"


def _claims(findings: Iterable[ClaimFinding]) -> Table:
    rows: list[Row] = []
    reasons: set[str] = set()
    for f in findings:
        rows.append((MARKS[f.verdict], f.claim.text, f.measured, f.expected))
        if f.reason:
            rows.append(Note("for the same reason" if f.reason in reasons else f.reason, " " * 7, later=9))
        reasons.add(f.reason)
    return Table((Column("", 4, left=True), Column("", 47, left=True), Column("", 10), Column("", 12, gap=2)), rows)


def _two(left: str, right: str) -> str:
    return f"{left}{right:>{WIDTH - len(left)}}" if len(left) + len(right) < WIDTH else f"{left}  {right}"


def _result(lines: Sequence[Block], facts: Mapping[str, object], holds: bool) -> Result:
    """The first line answers; what is wider than the page is folded."""
    first, *others = [_folded(line) if isinstance(line, str) and len(line) > WIDTH else line for line in lines]
    return Result(first, others, facts, exit_code=0 if holds else 1)


def _folded(line: str) -> Note:
    return Note(line, later=len(line) - len(line.lstrip()) + 2)
