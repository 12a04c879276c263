"""Claims beside what was measured, as text of at most 80 columns: the verdict first."""

from collections.abc import Iterable, Sequence

from twin.studies.lines import WIDTH, counted, wrapped
from twin.studies.paper.claim import ClaimFinding
from twin.studies.paper.fig4 import Score, bound_used, standing, tally
from twin.studies.paper.fig5 import Fig5Score, TaskScore

MARKS = {
    "holds": "ok", "fails": "FAIL", "trivial": "n/a", "not reproduced": "miss", "reproduced after all": "ok !",
    "not scored": "?",
}  # fmt: skip
FEW = 4
"""More runs than these become a table."""
KINDS = ("press", "tap", "roll", "push")


def fig4_text(score: Score) -> str:
    """Fig. 4: the claims of the paper, then ours on the true force."""
    lines = []
    if score.unscored:
        lines += [f"Not scored: {counted(len(score.unscored), 'claim')}, marked ?, for want of what a run lacks:"]
        lines += [f"  {run}: no {', '.join(series)}" for run, series in score.missing.items()]
    lines += [_two("Fig. 4: force-position control", standing(score.claims))]
    lines += _lines(score.claims)
    if not score.without_x:
        lines += ["  Imperfect: scale tilted, encoders off zero. All other rows: the ideal runs."]
    lines += ["", "Judged on the true contact force, force-position run", *_lines(score.quality)]
    if score.reproduced_after_all:
        lines += [f"'ok !': known not to be reproduced, and reproduced here: {', '.join(score.reproduced_after_all)}."]
    lines += ["", "Tuned to meet the text: " + ", ".join(sorted(key.rpartition(".")[2] for key in score.tuned))]
    lines += [f"Out of scope: {text}" for text in score.out_of_scope]
    return _text(lines)


def fig5_text(score: Fig5Score) -> str:
    """Fig. 5: every claim on every task of a few runs; of many runs a table, and what fails in them."""
    held, judged = tally(score.findings)
    lines = [_two("Fig. 5: pressing, tapping, rolling, pushing", f"{held} of {judged} claims hold")]
    runs = {task.run.recording.path for task in score.tasks}
    if len(runs) > FEW:
        return _text([*lines, "", *_table(score.tasks), "", *_failures(score.tasks), "", *score.remarks])
    lines += [*score.remarks, ""]
    for task in score.tasks:
        lines += [_two(f"{task.name}: {task.manner}", f"{task.drive} on {task.body}"), *_lines(task.findings), ""]
    return _text([*lines, "All are judged on the true force and the true position."])


def _table(tasks: Sequence[TaskScore]) -> list[str]:
    rows: dict[tuple[str, str], dict[str, list[ClaimFinding]]] = {}
    for task in tasks:
        rows.setdefault((task.drive, task.body), {}).setdefault(task.kind, []).extend(task.findings)
    lines = [f"{'drive':18} {'body':9}" + "".join(f"{kind:>13}" for kind in KINDS)]
    for (drive, body), kinds in rows.items():
        lines.append(f"{drive:18.18} {body:9.9}" + "".join(f"{_cell(kinds.get(kind, [])):>13}" for kind in KINDS))
    return [*lines, "Claims held/judged, and how much of its bound the worst measure takes."]


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


def _lines(findings: Iterable[ClaimFinding]) -> list[str]:
    lines: list[str] = []
    said: set[str] = set()
    for f in findings:
        lines.append(f"  {MARKS[f.verdict]:4} {f.claim.text:47} {f.measured:>10}  {f.expected:>12}".rstrip())
        lines += [f"       {'for the same reason' if f.reason in said else f.reason}"] if f.reason else []
        said.add(f.reason)
    return lines


def _two(left: str, right: str) -> str:
    return f"{left}{right:>{WIDTH - len(left)}}" if len(left) + len(right) < WIDTH else f"{left}  {right}"


def _text(lines: Iterable[str]) -> str:
    return "\n".join(part for line in lines for part in _folded(line))


def _folded(line: str) -> list[str]:
    return wrapped(line, later=len(line) - len(line.lstrip()) + 2) if len(line) > WIDTH else [line]
