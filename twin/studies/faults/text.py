"""The matrix of faults as text of at most 80 columns and as a picture."""

from collections.abc import Iterator, Sequence
from dataclasses import replace
from itertools import groupby
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np

from twin.kernel.serialise import to_dict
from twin.robot.experiment.fault import FAULT_KINDS
from twin.studies.faults import SetOfFaults
from twin.studies.faults.matrix import FORCE_ALLOWANCE, MAX_IDEAL_SHARE, FaultRow
from twin.studies.faults.offsets import NO_OFFSET
from twin.studies.faults.together import MAX_PEAK_SHARE, CombinationRow
from twin.studies.figure import BARE_STYLE, INK, LESS_IS_BETTER, LIGHT_IS_GOOD, VERMILION, Axes, picture
from twin.studies.result import Block, Column, Note, Result, Table, count_text

if TYPE_CHECKING:
    from matplotlib.cm import ScalarMappable

UNIT_TEXTS = {
    None: "",
    "share": "",
    "factor": "x",
    "deg_per_s": "deg/s",
    "rad_per_s": "rad/s",
    "Nm_s_per_rad": "Nms/rad",
}
"""Units of the catalogue as people write them, where that differs."""
SET_TITLES = {SetOfFaults.COMMON: "common causes", SetOfFaults.PAIRS: "pairs"}
SINGULAR_FORCE = 100.0
"""Force (N) beyond which the mechanism is near its singular pose, and larger forces are no forecast."""
FAULT_COLUMNS = (
    Column("largest forces", 20, left=True),
    Column("", 12, left=True),
    Column("onset", 5, unit="s"),
    Column("peak", 5, unit="N"),
    Column("without", 7, unit="N"),
    Column("seen", 4),
    Column("by", 14, ".14s", left=True),
    Column("after", 6, unit="s"),
)
COMBINATION_COLUMNS = (
    Column("worst of each", 34, ".34s", left=True),
    Column("on", 9, ".9s", left=True),
    Column("peak", 5, unit="N"),
    Column("ideal", 5, unit="N"),
    Column("w/o", 5, unit="N"),
    Column("left", 4, unit="N"),
    Column("seen", 5, unit="s"),
    Column("limit", 5, unit="N"),
)
MOVED_COLUMNS = (
    replace(COMBINATION_COLUMNS[0], width=26, form=".26s"),
    COMBINATION_COLUMNS[1],
    Column("at mm", 7, left=True),
    *COMBINATION_COLUMNS[2:],
)
MAX_SHOWN = 5
"""Maximum number of kinds, common causes and pairs in the text without `--all`, those with the largest force."""
MAX_SHADE = 2.0
"""Peak over force limit at the end of the colour scale."""
SIZE_COUNT = 3
"""Number of magnitudes of a kind; the cell of a kind without magnitudes is as wide as all."""


def fault_matrix_result(
    experiment: str,
    rows: Sequence[FaultRow],
    picture: Path,
    together: Sequence[CombinationRow] = (),
    complete: bool = False,
) -> Result:
    """Create the report of one matrix, kind by kind; `complete` for every kind in order, and all exceptions."""
    first = rows[0]
    safe, safe_unwatched = sum(r.is_safe for r in rows), sum(r.is_safe_without_monitor for r in rows)
    failing = any(r.fails for r in rows) or any(r.fails for r in together)
    sets = f" Common causes and pairs: {sum(not r.fails for r in together)} of {len(together)} below their limits."
    allowed, unavoidable = [r for r in rows if r.expects_excess], sum(r.is_unavoidable for r in rows)
    stated = sum(not r.is_safe for r in allowed)
    beyond = f", {stated} beyond as stated" if stated else ""
    beyond += f", {unavoidable} beyond as with an ideal monitor" if unavoidable else ""
    verdict = (
        f"{experiment}  {'FAILED' if failing else 'as stated'}: {safe} of {len(rows)} below {first.force_bound:g} N, "
        f"the limit of {first.limit:g} N plus {100 * (FORCE_ALLOWANCE - 1):.0f} %{beyond}; without the monitor "
        f"{safe_unwatched} below. Healthy: no trip, at most {max(r.healthy_peak for r in rows):.1f} N."
        f"{sets if together else ''}"
    )
    claimed = [r for r in rows if r.expects_detection]
    counts = (
        f"Expected: {len(claimed)} cases detected, up to {len(allowed)} above {first.force_bound:g} N. "
        f"Found: {sum(r.is_detected for r in claimed)} of these detected, {stated} of these "
        f"above, {sum(r.is_avoidable_excess for r in rows)} others above"
        f"{f', {unavoidable} more with an ideal monitor, too' if unavoidable else ''}."
    )
    ended = sum(r.unwatched.end == "run ended" and r.watched.end != "run ended" for r in rows)
    early = (
        f"Without the monitor {ended} more runs end early because a component fails; their peak is the one until then."
    )
    kinds = list(_worst(rows))
    shown = kinds if complete else sorted(kinds, key=lambda worst: -worst[0].watched.peak)[:MAX_SHOWN]
    title = replace(FAULT_COLUMNS[0], name="worst of each kind") if complete else FAULT_COLUMNS[0]
    largest = Table(
        (title, *FAULT_COLUMNS[1:]), [(row.kind, *_cells(row, of_kind)) for row, of_kind in shown], indent=0
    )
    parts: list[Block] = [Note(counts, later=4), *([Note(early, later=4)] if ended else []), "", largest]
    parts += [*_exceptions(rows, complete), *combination_blocks(together, complete), ""]
    if not complete:
        parts += [f"{len(shown)} of {count_text(len(kinds), 'kind')}; --all prints every kind and every exception"]
    facts = {"experiment": experiment, "rows": [row.to_dict() for row in rows], "together": to_dict(together)}
    return Result(Note(verdict, later=4), parts, facts, {"picture": picture}, label=0, exit_code=int(failing))


def combination_result(
    experiment: str, rows: Sequence[CombinationRow], wanted: Sequence[SetOfFaults], complete: bool = False
) -> Result:
    failing = sum(row.fails for row in rows)
    names = " and ".join(SET_TITLES.get(one, one) for one in wanted)
    verdict = (
        f"{experiment}  {'FAILED' if failing else 'as stated'}: {len(rows) - failing} of "
        f"{count_text(len(rows), 'case')} of {names} below their limits."
    )
    facts = {"experiment": experiment, "rows": [], "together": to_dict(rows)}
    return Result(Note(verdict, later=4), combination_blocks(rows, complete), facts, exit_code=int(failing > 0))


def combination_blocks(rows: Sequence[CombinationRow], complete: bool = False) -> list[Block]:
    """Format the worst rows of each list of combined faults, and the number of failures."""
    blocks: list[Block] = []
    for kind, title in SET_TITLES.items():
        of_kind = sorted((row for row in rows if row.faults.kind is kind), key=lambda row: -row.watched.peak)
        if not of_kind:
            continue
        count = {verdict: sum(row.verdict == verdict for row in of_kind) for verdict in ("kept", "beyond", "missed")}
        text = (
            f"{len(of_kind)} {title}: {count['kept']} below their limit, {count['beyond']} above (!), "
            f"{count['missed']} not detected although expected (!); {sum(row.is_detected for row in of_kind)} of "
            f"{len(of_kind)} detected. Limit: {MAX_PEAK_SHARE * of_kind[0].limit:g} N, {MAX_PEAK_SHARE:g} times the "
            f"monitor's, or (~) {MAX_IDEAL_SHARE:g} times the peak with an ideal monitor, which cuts all power when "
            "this one trips."
        )
        # of equal names the worst comes first
        worst = {row.faults.name: row for row in reversed(of_kind)}
        shown = sorted(worst.values(), key=lambda row: -row.watched.peak)
        if not complete:
            # a failure is always shown
            shown = [row for position, row in enumerate(shown) if position < MAX_SHOWN or row.fails]
        moved = any(row.stage.offset != NO_OFFSET for row in rows)
        cells = [_combination_cells(row, moved) for row in shown]
        blocks += ["", Note(text, later=4), Table(MOVED_COLUMNS if moved else COMBINATION_COLUMNS, cells, indent=0)]
        if len(shown) < len(worst):
            blocks += [f"  {len(shown)} of {len(worst)}; --all prints all"]
    return blocks


def _combination_cells(row: CombinationRow, moved: bool) -> tuple[str, ...]:
    def seconds(value: float | None) -> str:
        return "-" if value is None else f"{value:.3f}"

    return (
        f"{'!' if row.fails else '~' if row.watched.peak > MAX_PEAK_SHARE * row.limit else ' '} {row.faults.name}",
        row.stage.body,
        *([", ".join(f"{1e3 * each:.3g}" for each in row.stage.offset)] if moved else []),
        _force(row.watched.peak),
        "-" if row.ideal is None else _force(row.ideal),
        _force(row.unwatched.peak),
        f"{row.watched.left:.1f}",
        seconds(row.watched.seen),
        f"{row.force_bound:.1f}",
    )


def magnitude_text(kind: str, magnitude: float | None) -> str:
    """Format the magnitude of a fault, `0.5 deg` or `3 x`; empty for kinds without a magnitude."""
    unit = FAULT_KINDS[kind].unit
    return "" if magnitude is None else f"{magnitude:g} {UNIT_TEXTS.get(unit, unit or '')}".rstrip()


def _worst(rows: Sequence[FaultRow]) -> Iterator[tuple[FaultRow, list[FaultRow]]]:
    """Yield the row with the largest printed force of each kind (of equals the largest fault), and the kind's rows."""
    for _, group in groupby(rows, lambda row: row.kind):
        of_kind = list(group)
        yield max(of_kind, key=lambda row: (round(row.watched.peak, 1), of_kind.index(row))), of_kind


def _cells(row: FaultRow, of_kind: Sequence[FaultRow]) -> tuple[str, ...]:
    return (
        magnitude_text(row.kind, row.magnitude),
        f"{row.onset:.2f}",
        f"{row.watched.peak:.1f}{'' if row.is_safe else '!'}",
        _force(max(r.unwatched.peak for r in of_kind)),
        f"{sum(r.is_detected for r in of_kind)}/{len(of_kind)}",
        row.watched.reason,
        "" if row.watched.seen is None else f"{row.watched.seen:.3f}",
    )


def _force(peak: float) -> str:
    return f">{SINGULAR_FORCE:g}" if peak > SINGULAR_FORCE else f"{peak:.1f}"


def _exceptions(rows: Sequence[FaultRow], complete: bool) -> Iterator[Block]:
    """Yield the failures, all rows above the bound, and if `complete` also the other exceptions that were expected."""
    kinds = list(dict.fromkeys(row.kind for row in rows))
    last = [
        row for row in rows if FAULT_KINDS[row.kind].detection == "if large" and row.is_largest and not row.is_detected
    ]
    above: dict[str, Sequence[FaultRow | str]] = {
        "! expected to be detected, and not detected:": [row for row in rows if row.misses_detection],
        "! above the bound, and not expected there:": [row for row in rows if row.is_avoidable_excess],
        "! above the bound, as with a monitor that cuts all power at the limit of force:": [
            row for row in rows if row.is_unavoidable
        ],
        "! above the bound, as expected:": [row for row in rows if not row.is_safe and row.expects_excess],
    }
    expected: dict[str, Sequence[FaultRow | str]] = {
        "not detectable:": [kind for kind in kinds if FAULT_KINDS[kind].detection == "no"],
        "detected in time, and not expected to be:": [
            row for row in rows if not row.matches_statement and not row.fails
        ],
        "not detected at the largest magnitude, as expected:": [row for row in last if not row.misses_detection],
    }
    for title, found in (above | expected if complete else above).items():
        yield from ["", title] if found else []
        for one in found:
            text = f"{one}: {FAULT_KINDS[one].reason}" if isinstance(one, str) else _row_text(one)
            yield Note(text, "  ", later=4)


def _row_text(row: FaultRow) -> str:
    fault = " ".join(filter(None, (row.kind, magnitude_text(row.kind, row.magnitude))))
    limit = "" if row.is_safe else f" (limit {row.force_bound:g} N)"
    seen = f"{row.watched.reason} after {1e3 * (row.watched.seen or 0.0):.0f} ms" if row.is_detected else "not detected"
    ideal = "" if row.ideal is None else f"; ideal {row.ideal:.1f} N"
    return f"{fault} at {row.onset:.2f} s: {row.watched.peak:.1f} N{limit}, {seen}{ideal}"


def draw_fault_matrix(experiment: str, rows: Sequence[FaultRow], path: Path) -> None:
    """Draw the fault matrix, of equal onsets, to `path` (PNG): a line per kind, the peak force in each cell."""
    from matplotlib.cm import ScalarMappable
    from matplotlib.colors import Normalize
    from matplotlib.lines import Line2D
    from matplotlib.patches import Rectangle

    kinds = [list(group) for _, group in groupby(rows, lambda row: row.kind)]
    onsets = list(dict.fromkeys(row.onset for row in rows))
    title = f"Faults in {experiment}: largest true contact force (N) from the onset on; limit {rows[0].limit:g} N"
    with picture(path, 5.0 + 2.8 * len(onsets), 2.2 + 0.31 * len(kinds), title, look=BARE_STYLE) as figure:
        panels = figure.subplots(1, 2, sharey=True)
        shade = ScalarMappable(Normalize(0.0, MAX_SHADE), LESS_IS_BETTER)
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
            Rectangle((0, 0), 1, 1, fill=False, ec=VERMILION, lw=2.2, label=f"beyond {FORCE_ALLOWANCE:g} of the limit"),
        ]
        figure.legend(handles=marks, loc="outside lower center", ncols=3)


def _draw_cell(axes: Axes, shade: "ScalarMappable", row: FaultRow, watched: bool, line: int, onset: int) -> None:
    from matplotlib.patches import Rectangle

    run, safe = (row.watched, row.is_safe) if watched else (row.unwatched, row.is_safe_without_monitor)
    place, wide = 0, SIZE_COUNT
    if row.magnitude is not None:
        place, wide = (FAULT_KINDS[row.kind].magnitudes or ()).index(row.magnitude), 1
    left = onset * SIZE_COUNT + place
    r, g, b, _ = color = shade.to_rgba(np.array([run.peak / row.limit]))[0]
    axes.add_patch(Rectangle((left, line), wide, 1, fc=color, ec="white", lw=0.6))
    if not safe:
        axes.add_patch(
            Rectangle((left + 0.06, line + 0.08), wide - 0.12, 0.84, fill=False, ec=VERMILION, lw=2.2, zorder=3)
        )
    ink = INK if 0.299 * r + 0.587 * g + 0.114 * b > 0.5 else "white"
    middle = left + 0.5 * wide
    axes.text(middle - 0.1, line + 0.52, f"{run.peak:.1f}", color=ink, ha="center", va="center", fontsize=7.5)
    if run.end == "run ended":
        axes.plot(middle + 0.36, line + 0.5, ls="", marker="x", color=ink, ms=4.5)
    elif run.reason:
        axes.plot(middle + 0.36, line + 0.5, ls="", marker="o", color=ink, ms=3.5)


def _kind_text(of_kind: Sequence[FaultRow]) -> str:
    sizes = list(dict.fromkeys(row.magnitude for row in of_kind))
    if sizes == [None]:
        return of_kind[0].kind
    *smaller, largest = sizes
    return f"{of_kind[0].kind}  " + ", ".join([f"{m:g}" for m in smaller] + [magnitude_text(of_kind[0].kind, largest)])


def _label(axes: Axes, rows: Sequence[FaultRow], onsets: Sequence[float], lines: int) -> None:
    in_contact = {row.onset: row.in_contact for row in rows}
    axes.set_xlim(0, SIZE_COUNT * len(onsets))
    axes.set_ylim(lines, 0)
    axes.set_xticks(np.arange(SIZE_COUNT * len(onsets)) + 0.5, ["small", "medium", "large"] * len(onsets), fontsize=7.5)
    axes.tick_params(length=0, top=False)
    for i, onset in enumerate(onsets):
        text = f"onset {onset:.2f} s, {'in contact' if in_contact[onset] else 'free'}"
        axes.text(SIZE_COUNT * (i + 0.5), -0.35, text, ha="center", va="bottom", fontsize=9)
        if i:
            axes.axvline(SIZE_COUNT * i, color=INK, lw=1.6)
    for side in axes.spines.values():
        side.set_visible(False)
