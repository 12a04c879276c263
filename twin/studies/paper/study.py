"""Scores of recordings on the paper's claims: text, facts and pictures."""

from collections.abc import Iterable, Mapping, Sequence
from pathlib import Path

from twin.kernel.errors import InputRefused
from twin.kernel.recording.folder import recording_in
from twin.kernel.recording.reader import Recording, read
from twin.kernel.serialise import to_dict
from twin.studies.command import write_verdict
from twin.studies.paper import fig5
from twin.studies.paper.claim import OWN_CHECKS, PAPER_CLAIMS, ClaimFinding, bound_usage, standing_text, tally
from twin.studies.paper.fig4 import FIG4_EXPERIMENTS, Fig4Score, fig4_score
from twin.studies.paper.fig4_figure import draw_fig4
from twin.studies.paper.fig4_measures import fig4_runs
from twin.studies.paper.fig5_figure import draw_fig5
from twin.studies.result import TEXT_WIDTH, Block, Column, Note, Result, Row, Table, count_text

VERDICT_MARKS = {
    "holds": "ok", "fails": "FAIL", "trivial": "n/a", "not reproduced": "miss", "reproduced after all": "ok !",
    "not scored": "?",
}  # fmt: skip
MAX_LISTED_RUNS = 4
"""Maximum number of runs that are listed; more become a table."""
TASK_KINDS = ("press", "tap", "roll", "push")
FIG5_EXPERIMENTS = ("pressing", "tapping", "rolling", "pushing")
FIGURE_EXPERIMENTS = {"fig4": FIG4_EXPERIMENTS, "fig5": FIG5_EXPERIMENTS}
RESULTS_FOLDER = Path("results")


def fig4_result(score: Fig4Score) -> Result:
    lines: list[Block] = []
    if score.unscored_keys:
        lines += [f"Not scored: {count_text(len(score.unscored_keys), 'claim')}, marked ?, whose series a run lacks:"]
        lines += [f"  {run}: no {', '.join(series)}" for run, series in score.missing.items()]
    lines += [_two_columns("Fig. 4", standing_text(score.claims, PAPER_CLAIMS)), _claims_table(score.claims)]
    if not score.without_x:
        lines += ["  Imperfect: scale tilted, encoders off zero. All other rows: the ideal runs."]
    lines += [
        "",
        _two_columns("Judged on the true contact force", standing_text(score.quality, OWN_CHECKS)),
        _claims_table(score.quality),
    ]
    if score.reproduced_keys:
        lines += [f"'ok !': known not to be reproduced, and reproduced here: {', '.join(score.reproduced_keys)}."]
    lines += ["", "Tuned to meet the text: " + ", ".join(sorted(key.rpartition(".")[2] for key in score.tuned))]
    lines += [f"Out of scope: {text}" for text in score.out_of_scope]
    return _result(lines, {"figure": "4"} | to_dict(score), not score.failed_keys and not score.unscored_keys)


def fig5_result(score: fig5.Fig5Score) -> Result:
    held, judged = tally(score.findings)
    lines: list[Block] = [_two_columns("Fig. 5", f"{held} of {judged} {PAPER_CLAIMS} hold")]
    runs = {task.path for task in score.tasks}
    if len(runs) > MAX_LISTED_RUNS:
        lines += ["", *_table(score.tasks), "", *_failures(score.tasks), "", *score.remarks]
    else:
        lines += [*score.remarks, ""]
        for task in score.tasks:
            title = _two_columns(f"{task.name}: {task.manner}", f"{task.drive} on {task.body}")
            lines += [title, _claims_table(task.findings), ""]
        lines += ["All are judged on the true force and the true position."]
    return _result(lines, {"figure": "5"} | to_dict(score), not score.failed_keys)


def _table(tasks: Sequence[fig5.TaskScore]) -> list[Block]:
    rows: dict[tuple[str, str], dict[str, list[ClaimFinding]]] = {}
    for task in tasks:
        rows.setdefault((task.drive, task.body), {}).setdefault(task.kind, []).extend(task.findings)
    cells = [
        [drive, body, *(_cell(kinds.get(kind, [])) for kind in TASK_KINDS)] for (drive, body), kinds in rows.items()
    ]
    names = Column("drive", 18, ".18s", left=True), Column("body", 9, ".9s", left=True)
    table = Table([*names, *(Column(kind, 12) for kind in TASK_KINDS)], cells, indent=0)
    return [table, "Claims held/judged, and how much of its bound the worst measure takes."]


def _cell(findings: Sequence[ClaimFinding]) -> str:
    held, judged = tally(findings)
    if not judged:
        return "-"
    worst = 100.0 * max(bound_usage(finding) for finding in findings if finding.verdict in ("holds", "fails"))
    return f"{held}/{judged} {'>999' if worst > 999.0 else format(worst, '.0f')} %"


def _failures(tasks: Sequence[fig5.TaskScore]) -> list[str]:
    """Return lines on failed claims of Fig. 5 per body, kind of task and claim: count, measured range, drives."""
    drives = {task.drive for task in tasks}
    groups: dict[tuple[str, str, str], list[tuple[str, ClaimFinding]]] = {}
    for task in tasks:
        for finding in task.findings:
            if finding.verdict in ("holds", "fails"):
                groups.setdefault((task.body, task.kind, finding.claim.key), []).append((task.drive, finding))
    lines = []
    for (body, kind, key), found in groups.items():
        failing = [(drive, finding) for drive, finding in found if finding.verdict == "fails"]
        if failing:
            names = list(dict.fromkeys(drive for drive, _ in failing))
            who = "every drive" if len(names) == len(drives) else ", ".join(names)
            place = f"FAIL {body:8.8} {kind:5} {key:14} {len(failing):>2} of {len(found):<2}"
            lines += [
                f"{place} {_range([finding for _, finding in failing]):>18} {failing[0][1].claim.bounds_text:>11}"
            ]
            lines += [f"       {who}"]
    return lines


def _range(findings: Sequence[ClaimFinding]) -> str:
    """Format the range of the measured values of a claim; `never` counts as the largest."""
    least, *_, largest = [*(ordered := sorted(findings, key=lambda f: f.value)), ordered[-1]]
    if least.measured_text == largest.measured_text:
        return least.measured_text
    return f"{least.measured_text.removesuffix(least.claim.unit).rstrip()} .. {largest.measured_text}"


def _claims_table(findings: Iterable[ClaimFinding]) -> Table:
    rows: list[Row] = []
    reasons: set[str] = set()
    for f in findings:
        rows.append((VERDICT_MARKS[f.verdict], f.claim.text, f.measured_text, f.claim.bounds_text))
        if f.reason:
            rows.append(Note("for the same reason" if f.reason in reasons else f.reason, " " * 7, later=9))
        reasons.add(f.reason)
    return Table((Column("", 4, left=True), Column("", 47, left=True), Column("", 10), Column("", 12, gap=2)), rows)


def _two_columns(left: str, right: str) -> str:
    return f"{left}{right:>{TEXT_WIDTH - len(left)}}" if len(left) + len(right) < TEXT_WIDTH else f"{left}  {right}"


def _result(lines: Sequence[Block], facts: Mapping[str, object], holds: bool) -> Result:
    """Return the report of a score with the first line as the answer; wide lines are folded."""
    first, *others = [
        Note(line, later=len(line) - len(line.lstrip()) + 2)
        if isinstance(line, str) and len(line) > TEXT_WIDTH
        else line
        for line in lines
    ]
    return Result(first, others, facts, exit_code=0 if holds else 1)


def score_fig4(paths: Sequence[Path], out: Path | None) -> Result:
    """Score two or four recordings, in the order of `FIG4_EXPERIMENTS`, or the latest of these, on Fig. 4.

    Files are written to `out`; None for results/fig4. Exit code 1: a claim fails, or a run lacks a series for it.
    """
    paths = paths or _latest("fig4")
    if len(paths) not in (2, 4):
        raise InputRefused(
            f"--paper fig4: got {len(paths)} run{'s' * (len(paths) != 1)}, expected two: the run with force control, "
            f"then the one without; or four: {', '.join(FIG4_EXPERIMENTS)}"
        )
    recordings = _recordings(paths)
    runs = fig4_runs(*recordings)
    score = fig4_score(runs)
    notes = [*(recording.note for recording in recordings if recording.note), *_deviations(recordings)]
    return write_verdict(
        "fig4", out or RESULTS_FOLDER / "fig4", fig4_result(score), lambda path: draw_fig4(runs, path), notes
    )


def score_fig5(paths: Sequence[Path], out: Path | None) -> Result:
    """Score runs of tasks, or the latest of `FIG5_EXPERIMENTS`, on the claims of Fig. 5.

    Files are written to `out`; None for results/fig5. Exit code 1: a claim fails.
    """
    recordings = _recordings(paths or _latest("fig5"))
    score = fig5.fig5_score(recordings)
    notes = _deviations(recordings)
    return write_verdict(
        "fig5", out or RESULTS_FOLDER / "fig5", fig5_result(score), lambda path: draw_fig5(score, path), notes
    )


def _deviations(recordings: Sequence[Recording]) -> list[str]:
    return [
        f"{recording.path}: {text}"
        for recording in recordings
        for text in (*recording.deviations, *recording.other_parts)
    ]


def _latest(figure: str) -> list[Path]:
    paths = [RESULTS_FOLDER / name for name in FIGURE_EXPERIMENTS[figure]]
    missing = [path.name for path in paths if not path.exists()]
    if missing:
        files = " ".join(f"experiments/{name}.toml" for name in missing)
        raise InputRefused(f"--paper {figure}: no run of {', '.join(missing)} in results/; first: twin run {files}")
    return paths


def _recordings(paths: Sequence[Path]) -> list[Recording]:
    return [read(recording_in(path)) for path in paths]
