"""The claims of the paper judged from recordings: text, the picture of Fig. 5, facts."""

import math
from collections.abc import Callable, Iterable, Mapping, Sequence
from contextlib import suppress
from pathlib import Path
from typing import Any

import numpy as np
from matplotlib.patches import Circle

from twin.kernel.errors import InputRefused, UnknownSeries
from twin.kernel.recording.folder import recording_in
from twin.kernel.recording.reader import Recording, read
from twin.robot.controller.program import PhaseKind, Push, Roll, Tap
from twin.robot.experiment.source import names_stand_in
from twin.robot.monitor.checks import Monitor
from twin.studies.command import judged
from twin.studies.figure import GREEN, ORANGE, Axes, picture
from twin.studies.metrics.response import along_and_off
from twin.studies.paper import fig5
from twin.studies.paper.claim import ClaimFinding
from twin.studies.paper.fig4 import FIG4_EXPERIMENTS, OWN, PAPERS, Score, bound_used, fig4_score, standing, tally
from twin.studies.paper.fig4_measures import draw_fig4, fig4_runs
from twin.studies.paper.fig5_measures import TaskRun, settings
from twin.studies.result import WIDTH, Block, Column, Note, Result, Row, Table, counted

ESTIMATE, SHIFTED = ORANGE, GREEN
JUDGED = "#e9eef5"
COLUMN, LEFT, RIGHT = 3.5, 0.803, 0.4088
"""Inches of a task's panels, and beside all of them for the numbers of their axes."""
LEGEND_COLUMNS = 2
"""Entries of the legend that fit below a task's panels, side by side."""
WORK = {"press": PhaseKind.HOLD, "roll": PhaseKind.CIRCLE, "push": PhaseKind.PUSH}
ALIKE = 0.35
"""Share of the reference by which a measured force may miss the limit of the monitor for both to fit one axis."""


def draw_fig5(score: fig5.Fig5Score, path: Path) -> None:
    """Write the picture to `path` (PNG): the last task of each kind of the first run that has one, a column each.

    A series that a run lacks is left out.
    """
    shown = fig5.shown_tasks(score)
    width = COLUMN * len(shown) + 0.6
    with picture(path, width, 9.6, by_hand=True) as figure:
        grid = figure.add_gridspec(
            3, len(shown), height_ratios=(1.45, 1.0, 1.0), hspace=0.24, wspace=0.28,
            left=LEFT / width, right=1.0 - RIGHT / width, top=0.92, bottom=0.08 + 0.02 * math.ceil(4 / len(shown)),
        )  # fmt: skip
        floor = min(float(task.run.p_B[:, 2].min()) for task in shown)
        for column, task in enumerate(shown):
            space = figure.add_subplot(grid[0, column], projection="3d")
            fig5.draw_in_space(space, task.run, floor)
            corner = {"transform": space.transAxes, "va": "bottom"}
            space.text2D(0.0, 1.115, fig5.TITLES[task.kind], fontweight="bold", fontsize=12, **corner)
            place = f"{task.drive} on {task.body}{', safety monitor tripped' * task.run.tripped}"
            space.text2D(0.0, 1.0, f"{task.manner}\n{place}", fontsize=8, **corner)
            way, force = (figure.add_subplot(grid[row, column]) for row in (1, 2))
            WAYS[task.kind](way, task.run)
            _draw_force(force, task.run)
            for axes in (way, force):
                axes.tick_params(labelsize=8)
        found = [axes.get_legend_handles_labels() for axes in figure.axes]
        marks = {label: mark for marks, labels in found for mark, label in zip(marks, labels, strict=True)}
        figure.legend(
            marks.values(),
            marks.keys(),
            loc="lower center",
            ncols=min(len(marks), LEGEND_COLUMNS * len(shown)),
            fontsize=9,
        )


def _draw_height(axes: Axes, run: TaskRun) -> None:
    seen = fig5.seen_part(run)
    t = run.t[seen]
    with suppress(UnknownSeries):
        axes.plot(t, 1e3 * run.commanded("p_cmd_B")[seen, 2], color=SHIFTED, lw=1.6, label="after the force loop")
    with suppress(UnknownSeries):
        axes.plot(t, 1e3 * run.commanded("p_ref_B")[seen, 2], color=fig5.REFERENCE, lw=1.6, ls="--", label="reference")
    axes.plot(t, 1e3 * run.p_B[seen, 2], color=fig5.TRUTH, lw=1.2, label="true")
    axes.set(xlabel="time (s)", ylabel="z (mm)", xlim=(t[0], t[-1]))


def _draw_circle(axes: Axes, run: TaskRun) -> None:
    assert isinstance(run.task, Roll)
    circling = run.during(PhaseKind.CIRCLE)
    x, y = 1e3 * run.p_B[circling, 0], 1e3 * run.p_B[circling, 1]
    axes.plot(x, y, color="#bbbbbb", lw=0.8)
    axes.plot(*(1e3 * run.p_B[run.full_turns, i] for i in (0, 1)), color=fig5.TRACE, lw=1.6, label="trace under force")
    axes.add_patch(_ring(run.task, 1.0, color=fig5.REFERENCE, lw=1.6, ls="--", label="reference"))
    for bound in (fig5.bound_of("radius").low, fig5.bound_of("radius").high):
        axes.add_patch(
            _ring(run.task, bound / fig5.bound_of("radius").scale, color=fig5.REFERENCE, lw=1.0, ls=":", label="bound")
        )
    axes.set(xlabel="x (mm)", ylabel="y (mm)")
    axes.set_aspect("equal", adjustable="datalim")


def _ring(task: Roll, share: float, **look: Any) -> Circle:
    """A circle about the point with a share of the radius asked for, in mm."""
    return Circle((1e3 * task.point[0], 1e3 * task.point[1]), 1e3 * share * task.radius, fill=False, **look)


def _draw_line(axes: Axes, run: TaskRun) -> None:
    assert isinstance(run.task, Push)
    along, off = along_and_off(run.p_B[run.during(PhaseKind.PUSH), :2], run.task.point, run.task.to)
    axes.plot(1e3 * along, 1e3 * off, color=fig5.TRACE, lw=1.8, label="trace under force")
    axes.axhline(0.0, color=fig5.REFERENCE, lw=1.6, ls="--", label="reference")
    for side in (-1.0, 1.0):
        axes.axhline(side * fig5.bound_of("line_worst").high, color=fig5.REFERENCE, lw=1.0, ls=":", label="bound")
    axes.set(xlabel="along the line (mm)", ylabel="off the line (mm)")


WAYS: dict[str, Callable[[Axes, TaskRun], None]] = {
    "press": _draw_height,
    "tap": _draw_height,
    "roll": _draw_circle,
    "push": _draw_line,
}
"""What the panel in the middle shows."""


def _draw_force(axes: Axes, run: TaskRun) -> None:
    seen = fig5.seen_part(run)
    t = run.t[seen]
    on = run.full_turns if isinstance(run.task, Roll) else run.during(WORK.get(run.task.kind, PhaseKind.TAP))
    if not isinstance(run.task, Tap) and np.any(on):
        axes.axvspan(run.t[on][0], run.t[on][-1], color=JUDGED, lw=0, label="judged")
    with suppress(UnknownSeries):
        axes.plot(t, run.commanded("F_z")[seen], color=ESTIMATE, lw=1.6, label="estimated")
    axes.plot(t, run.F_z[seen], color=fig5.TRUTH, lw=1.1, label="true")
    if isinstance(run.task, Tap):
        axes.axhline(run.task.force, color=fig5.REFERENCE, lw=1.6, ls="--", label="reference")
    else:
        with suppress(UnknownSeries):
            axes.plot(t, run.commanded("F_z_ref")[seen], color=fig5.REFERENCE, lw=1.6, ls="--", label="reference")
    limit = _force_limit(run)
    if limit is not None and limit <= (1.0 + ALIKE) * max(run.F_z.max(), run.task.force):
        axes.axhline(limit, color=fig5.TRACE, lw=1.2, ls=":", label="monitor's limit")
    axes.set(xlabel="time (s)", ylabel="pressing force F_z (N)", xlim=(t[0], t[-1]))
    axes.set_ylim(-0.12 * run.task.force, max(axes.get_ylim()[1], 1.06 * run.task.force))


def _force_limit(run: TaskRun) -> float | None:
    """Force (N) at which the safety monitor trips; None without one, or with a third-party one."""
    table = settings(run.recording).get("monitor")
    if table is None or names_stand_in(table):
        return None
    return Monitor.model_validate(table).force_limit


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
    lines += [_two("Fig. 4", standing(score.claims, PAPERS)), _claims(score.claims)]
    if not score.without_x:
        lines += ["  Imperfect: scale tilted, encoders off zero. All other rows: the ideal runs."]
    lines += [
        "",
        _two("Judged on the true contact force", standing(score.quality, OWN)),
        _claims(score.quality),
    ]
    if score.reproduced_after_all:
        lines += [f"'ok !': known not to be reproduced, and reproduced here: {', '.join(score.reproduced_after_all)}."]
    lines += ["", "Tuned to meet the text: " + ", ".join(sorted(key.rpartition(".")[2] for key in score.tuned))]
    lines += [f"Out of scope: {text}" for text in score.out_of_scope]
    return _result(lines, score.facts(), not score.failed and not score.unscored)


def fig5_result(score: fig5.Fig5Score) -> Result:
    """Fig. 5: every claim on every task of a few runs; of many runs a table, and what fails in them."""
    held, judged = tally(score.findings)
    lines: list[Block] = [_two("Fig. 5", f"{held} of {judged} {PAPERS} hold")]
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


def _table(tasks: Sequence[fig5.TaskScore]) -> list[Block]:
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


def _failures(tasks: Sequence[fig5.TaskScore]) -> list[str]:
    """What fails, one line per body, kind of task and claim: how often, the range measured, and with which drives."""
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


FIG5_EXPERIMENTS = ("pressing", "tapping", "rolling", "pushing")
FIGURE_EXPERIMENTS = {"fig4": FIG4_EXPERIMENTS, "fig5": FIG5_EXPERIMENTS}
HOME = Path("results")


def score_fig4(paths: Sequence[Path], out: Path | None) -> Result:
    """Which claims of Fig. 4 hold in recordings, and files in `out`, or results/fig4.

    Exit code 1: a claim fails, or cannot be scored because a run lacks a series.

    Args:
        paths: runs, in the order of `FIG4_EXPERIMENTS`, the first two or all; none: the latest in results/.
        out: folder; None: results/fig4.

    Raises:
        InputRefused: other runs, or what they hold or the folder cannot be used.
        NotWritten: the disk refuses.
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
    return judged("fig4", out or HOME / "fig4", fig4_result(score), lambda path: draw_fig4(runs, path), notes)


def score_fig5(paths: Sequence[Path], out: Path | None) -> Result:
    """Which claims of Fig. 5 hold in recordings, and files in `out`, or results/fig5.

    Exit code 1: a claim fails.

    Args:
        paths: runs of tasks; none: the latest of `FIG5_EXPERIMENTS` in results/.
        out: folder; None: results/fig5.

    Raises:
        InputRefused: what the runs hold or the folder cannot be used.
        NotWritten: the disk refuses.
    """
    recordings = _recordings(paths or _latest("fig5"))
    score = fig5.fig5_score(recordings)
    notes = _deviations(recordings)
    return judged("fig5", out or HOME / "fig5", fig5_result(score), lambda path: draw_fig5(score, path), notes)


def _deviations(recordings: Sequence[Recording]) -> list[str]:
    return [
        f"{recording.path}: {text}"
        for recording in recordings
        for text in (*recording.deviations, *recording.other_parts)
    ]


def _latest(figure: str) -> list[Path]:
    paths = [HOME / name for name in FIGURE_EXPERIMENTS[figure]]
    missing = [path.name for path in paths if not path.exists()]
    if missing:
        files = " ".join(f"experiments/{name}.toml" for name in missing)
        raise InputRefused(f"--paper {figure}: no run of {', '.join(missing)} in results/; first: twin run {files}")
    return paths


def _recordings(paths: Sequence[Path]) -> list[Recording]:
    return [read(recording_in(path)) for path in paths]
