"""The matrix of faults as text of at most 80 columns, as a Markdown table and as a picture."""

from collections.abc import Iterator, Sequence
from dataclasses import replace
from itertools import groupby
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np

from twin.robot.experiment.fault import CATALOGUE
from twin.studies.faults.matrix import ALLOWANCE, OF_IDEAL, FaultRow
from twin.studies.faults.offsets import HERE
from twin.studies.faults.together import REACHABLE, FaultSet, TogetherRow
from twin.studies.figure import BARE, INK, LESS_IS_BETTER, LIGHT_IS_GOOD, VERMILION, Axes, picture
from twin.studies.result import Block, Column, Note, Result, Table, counted

if TYPE_CHECKING:
    from matplotlib.cm import ScalarMappable

UNITS = {
    None: "",
    "share": "",
    "factor": "x",
    "deg_per_s": "deg/s",
    "rad_per_s": "rad/s",
    "Nm_s_per_rad": "Nms/rad",
}
"""Units of the catalogue as people write them, where that differs."""
SINGULAR = 100.0
"""Force (N) that springs and body of this robot do not make: a mechanism near its singular pose does, before the run
ends. How far beyond is no forecast."""
COLUMNS = (
    Column("worst of each kind", 20, left=True),
    Column("", 12, left=True),
    Column("onset", 5, unit="s"),
    Column("peak", 5, unit="N"),
    Column("without", 7, unit="N"),
    Column("seen", 4),
    Column("by", 14, ".14s", left=True),
    Column("after", 6, unit="s"),
)
TOGETHER = (
    Column("worst of each", 34, ".34s", left=True),
    Column("on", 9, ".9s", left=True),
    Column("peak", 5, unit="N"),
    Column("ideal", 5, unit="N"),
    Column("w/o", 5, unit="N"),
    Column("left", 4, unit="N"),
    Column("seen", 5, unit="s"),
    Column("limit", 5, unit="N"),
)
MOVED = (
    replace(TOGETHER[0], width=26, form=".26s"),
    TOGETHER[1],
    Column("at mm", 7, left=True),
    *TOGETHER[2:],
)
"""The same, where the tasks were moved, too."""
SHOWN = 12
"""Causes of each list that the text shows, the worst first; all rows are in the files."""
BEYOND = VERMILION
DARKEST = 2.0
"""Peak over limit at which the colours end."""
SIZES = 3
"""Magnitudes of a kind; a kind that has none takes the room of all."""


def fault_matrix_result(
    experiment: str, rows: Sequence[FaultRow], picture: Path, together: Sequence[TogetherRow] = ()
) -> Result:
    """The verdict, then the worst case of each kind, then what the verdict does not cover.

    Args:
        experiment: its name.
        rows: of one matrix, kind by kind, at least one.
        picture: where it is.
        together: common causes and pairs.
    """
    first = rows[0]
    safe, safe_unwatched = sum(r.safe for r in rows), sum(r.safe_unwatched for r in rows)
    failing = any(r.fails for r in rows) or any(r.fails for r in together)
    sets = f" Common causes and pairs: {sum(not r.fails for r in together)} of {len(together)} below their limits."
    allowed, unavoidable = [r for r in rows if r.expected_beyond], sum(r.unavoidable for r in rows)
    stated = sum(not r.safe for r in allowed)
    beyond = f", {stated} beyond as stated" if stated else ""
    beyond += f", {unavoidable} beyond as with an ideal monitor" if unavoidable else ""
    verdict = (
        f"{experiment}  {'FAILED' if failing else 'as stated'}: {safe} of {len(rows)} below {first.bound:g} N, the "
        f"limit of {first.limit:g} N plus {100 * (ALLOWANCE - 1):.0f} %{beyond}; without the monitor "
        f"{safe_unwatched} below. Healthy: no trip, at most {max(r.healthy_peak for r in rows):.1f} N."
        f"{sets if together else ''}"
    )
    claimed = [r for r in rows if r.detection_expected]
    counts = (
        f"Expected: {len(claimed)} cases detected, up to {len(allowed)} above {first.bound:g} N. "
        f"Found: {sum(r.detected for r in claimed)} of these detected, {stated} of these "
        f"above, {sum(r.loose for r in rows)} others above"
        f"{f', {unavoidable} more with an ideal monitor, too' if unavoidable else ''}."
    )
    ended = sum(r.unwatched.end == "run ended" and r.watched.end != "run ended" for r in rows)
    early = (
        f"Without the monitor {ended} more runs end early because a component fails; their peak is the one until then."
    )
    worst = Table(COLUMNS, [(row.kind, *_cells(row, of_kind)) for row, of_kind in _worst(rows)], indent=0)
    parts = [Note(counts, later=4), *([Note(early, later=4)] if ended else []), "", worst, *_exceptions(rows)]
    parts += [*together_blocks(together), ""]
    facts = {"experiment": experiment, "rows": [row.facts() for row in rows]}
    facts["together"] = [row.facts() for row in together]
    return Result(Note(verdict, later=4), parts, facts, {"picture": picture}, label=0, exit_code=int(failing))


def together_result(experiment: str, rows: Sequence[TogetherRow], wanted: Sequence[FaultSet]) -> Result:
    """The verdict on common causes and pairs alone."""
    failing = sum(row.fails for row in rows)
    names = " and ".join({FaultSet.COMMON: "common causes", FaultSet.PAIRS: "pairs"}.get(one, one) for one in wanted)
    verdict = (
        f"{experiment}  {'FAILED' if failing else 'as stated'}: {len(rows) - failing} of "
        f"{counted(len(rows), 'case')} of {names} below their limits."
    )
    facts = {"experiment": experiment, "rows": [], "together": [row.facts() for row in rows]}
    return Result(Note(verdict, later=4), together_blocks(rows), facts, exit_code=int(failing > 0))


def together_blocks(rows: Sequence[TogetherRow]) -> list[Block]:
    """Of each list the worst rows, and how many fail."""
    blocks: list[Block] = []
    for kind, title in ((FaultSet.COMMON, "common causes"), (FaultSet.PAIRS, "pairs")):
        of_kind = sorted((row for row in rows if row.faults.kind is kind), key=lambda row: -row.watched.peak)
        if not of_kind:
            continue
        count = {verdict: sum(row.verdict == verdict for row in of_kind) for verdict in ("kept", "beyond", "missed")}
        text = (
            f"{len(of_kind)} {title}: {count['kept']} below their limit, {count['beyond']} above (!), "
            f"{count['missed']} not detected although expected (!); {sum(row.detected for row in of_kind)} of "
            f"{len(of_kind)} detected. Limit: {REACHABLE * of_kind[0].limit:g} N, {REACHABLE:g} times the monitor's, "
            f"or (~) {OF_IDEAL:g} times the peak with an ideal monitor, which cuts all power when this one trips."
        )
        # of equal names the worst comes first
        worst = {row.faults.name: row for row in reversed(of_kind)}
        shown = sorted(worst.values(), key=lambda row: -row.watched.peak)[:SHOWN]
        moved = any(row.stage.offset != HERE for row in rows)
        cells = [_together_cells(row, moved) for row in shown]
        blocks += ["", Note(text, later=4), Table(MOVED if moved else TOGETHER, cells, indent=0)]
    return blocks


def _together_cells(row: TogetherRow, moved: bool) -> tuple[str, ...]:
    def seconds(value: float | None) -> str:
        return "-" if value is None else f"{value:.3f}"

    return (
        f"{'!' if row.fails else '~' if row.watched.peak > REACHABLE * row.limit else ' '} {row.faults.name}",
        row.stage.body,
        *([", ".join(f"{1e3 * each:.3g}" for each in row.stage.offset)] if moved else []),
        _force(row.watched.peak),
        "-" if row.ideal is None else _force(row.ideal),
        _force(row.unwatched.peak),
        f"{row.watched.left:.1f}",
        seconds(row.watched.seen),
        f"{row.bound:.1f}",
    )


def magnitude_text(kind: str, magnitude: float | None) -> str:
    """`0.5 deg`, `3 x`; empty where the kind has no magnitude."""
    unit = CATALOGUE[kind].unit
    return "" if magnitude is None else f"{magnitude:g} {UNITS.get(unit, unit or '')}".rstrip()


def _worst(rows: Sequence[FaultRow]) -> Iterator[tuple[FaultRow, list[FaultRow]]]:
    """Of each kind the row with the largest force as printed (of equals the largest fault), and all its rows."""
    for _, group in groupby(rows, lambda row: row.kind):
        of_kind = list(group)
        yield max(of_kind, key=lambda row: (round(row.watched.peak, 1), of_kind.index(row))), of_kind


def _cells(row: FaultRow, of_kind: Sequence[FaultRow]) -> tuple[str, ...]:
    return (
        magnitude_text(row.kind, row.magnitude),
        f"{row.onset:.2f}",
        f"{row.watched.peak:.1f}{'' if row.safe else '!'}",
        _force(max(r.unwatched.peak for r in of_kind)),
        f"{sum(r.detected for r in of_kind)}/{len(of_kind)}",
        row.watched.reason,
        "" if row.watched.seen is None else f"{row.watched.seen:.3f}",
    )


def _force(peak: float) -> str:
    return f">{SINGULAR:g}" if peak > SINGULAR else f"{peak:.1f}"


def _exceptions(rows: Sequence[FaultRow]) -> Iterator[Block]:
    kinds = list(dict.fromkeys(row.kind for row in rows))
    last = [row for row in rows if CATALOGUE[row.kind].detection == "if large" and row.largest and not row.detected]
    blocks: dict[str, Sequence[FaultRow | str]] = {
        "! expected to be detected, and not detected:": [row for row in rows if row.missed],
        "! above the bound, and not expected there:": [row for row in rows if row.loose],
        "! above the bound, as with a monitor that cuts all power at the limit of force:": [
            row for row in rows if row.unavoidable
        ],
        "! above the bound, as expected:": [row for row in rows if not row.safe and row.expected_beyond],
        "not detectable:": [kind for kind in kinds if CATALOGUE[kind].detection == "no"],
        "detected in time, and not expected to be:": [row for row in rows if not row.as_stated and not row.fails],
        "not detected at the largest magnitude, as expected:": [row for row in last if not row.missed],
    }
    for title, found in blocks.items():
        yield from ["", title] if found else []
        for one in found:
            text = f"{one}: {CATALOGUE[one].reason}" if isinstance(one, str) else _named(one)
            yield Note(text, "  ", later=4)


def _named(row: FaultRow) -> str:
    fault = " ".join(filter(None, (row.kind, magnitude_text(row.kind, row.magnitude))))
    limit = "" if row.safe else f" (limit {row.bound:g} N)"
    seen = f"{row.watched.reason} after {1e3 * (row.watched.seen or 0.0):.0f} ms" if row.detected else "not detected"
    ideal = "" if row.ideal is None else f"; ideal {row.ideal:.1f} N"
    return f"{fault} at {row.onset:.2f} s: {row.watched.peak:.1f} N{limit}, {seen}{ideal}"


def draw_fault_matrix(experiment: str, rows: Sequence[FaultRow], path: Path) -> None:
    """Write the picture to `path` (PNG): a line per kind, a column per onset and magnitude, the peak force in each.

    Args:
        experiment: its name.
        rows: of one matrix, kind by kind, the same onsets for each.
    """
    from matplotlib.cm import ScalarMappable
    from matplotlib.colors import Normalize
    from matplotlib.lines import Line2D
    from matplotlib.patches import Rectangle

    kinds = [list(group) for _, group in groupby(rows, lambda row: row.kind)]
    onsets = list(dict.fromkeys(row.onset for row in rows))
    title = f"Faults in {experiment}: largest true contact force (N) from the onset on; limit {rows[0].limit:g} N"
    with picture(path, 5.0 + 2.8 * len(onsets), 2.2 + 0.31 * len(kinds), title, look=BARE) as figure:
        panels = figure.subplots(1, 2, sharey=True)
        shade = ScalarMappable(Normalize(0.0, DARKEST), LESS_IS_BETTER)
        for axes, watched in zip(panels, (True, False), strict=True):
            for line, of_kind in enumerate(kinds):
                for row in of_kind:
                    _draw_cell(axes, shade, row, watched, line, onsets.index(row.onset))
            _label(axes, rows, onsets, len(kinds))
            axes.set_title("with monitor" if watched else "without monitor", fontweight="bold", pad=22)
        panels[0].set_yticks(np.arange(len(kinds)) + 0.5, [_kind_text(of_kind) for of_kind in kinds], fontsize=8.5)
        label = f"largest true force / force limit {LIGHT_IS_GOOD}"
        figure.colorbar(shade, ax=panels, extend="max", shrink=0.6, pad=0.01, label=label)
        marks = [
            Line2D([], [], ls="", marker="o", color=INK, ms=4, label="seen by the monitor"),
            Line2D([], [], ls="", marker="x", color=INK, ms=5, label="run ended there: a component failed"),
            Rectangle((0, 0), 1, 1, fill=False, ec=BEYOND, lw=2.2, label=f"beyond {ALLOWANCE:g} of the limit"),
        ]
        figure.legend(handles=marks, loc="outside lower center", ncols=3)


def _draw_cell(axes: Axes, shade: "ScalarMappable", row: FaultRow, watched: bool, line: int, onset: int) -> None:
    from matplotlib.patches import Rectangle

    run, safe = (row.watched, row.safe) if watched else (row.unwatched, row.safe_unwatched)
    wide = SIZES if row.magnitude is None else 1
    left = onset * SIZES + (0 if row.magnitude is None else _size(row))
    r, g, b, _ = color = shade.to_rgba(np.array([run.peak / row.limit]))[0]
    axes.add_patch(Rectangle((left, line), wide, 1, fc=color, ec="white", lw=0.6))
    if not safe:
        axes.add_patch(
            Rectangle((left + 0.06, line + 0.08), wide - 0.12, 0.84, fill=False, ec=BEYOND, lw=2.2, zorder=3)
        )
    ink = INK if 0.299 * r + 0.587 * g + 0.114 * b > 0.5 else "white"
    middle = left + 0.5 * wide
    axes.text(middle - 0.1, line + 0.52, f"{run.peak:.1f}", color=ink, ha="center", va="center", fontsize=7.5)
    if run.end == "run ended":
        axes.plot(middle + 0.36, line + 0.5, ls="", marker="x", color=ink, ms=4.5)
    elif run.reason:
        axes.plot(middle + 0.36, line + 0.5, ls="", marker="o", color=ink, ms=3.5)


def _size(row: FaultRow) -> int:
    """Which of the kind's magnitudes it is, from 0."""
    return (CATALOGUE[row.kind].magnitudes or ()).index(row.magnitude or 0.0)


def _kind_text(of_kind: Sequence[FaultRow]) -> str:
    sizes = list(dict.fromkeys(row.magnitude for row in of_kind))
    if sizes == [None]:
        return of_kind[0].kind
    *smaller, largest = sizes
    return f"{of_kind[0].kind}  " + ", ".join([f"{m:g}" for m in smaller] + [magnitude_text(of_kind[0].kind, largest)])


def _label(axes: Axes, rows: Sequence[FaultRow], onsets: Sequence[float], lines: int) -> None:
    in_contact = {row.onset: row.in_contact for row in rows}
    axes.set_xlim(0, SIZES * len(onsets))
    axes.set_ylim(lines, 0)
    axes.set_xticks(np.arange(SIZES * len(onsets)) + 0.5, ["small", "medium", "large"] * len(onsets), fontsize=7.5)
    axes.tick_params(length=0, top=False)
    for i, onset in enumerate(onsets):
        text = f"onset {onset:.2f} s, {'in contact' if in_contact[onset] else 'free'}"
        axes.text(SIZES * (i + 0.5), -0.35, text, ha="center", va="bottom", fontsize=9)
        if i:
            axes.axvline(SIZES * i, color=INK, lw=1.6)
    for side in axes.spines.values():
        side.set_visible(False)
