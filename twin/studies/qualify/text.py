"""The results of a drive on the bench, as text of at most 80 columns and as a picture."""

from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

import numpy as np

from twin.robot.run.hold import SETTLING_BAND
from twin.robot.run.measures import ROWS_BY_KEY as MEASURES_OF_RUNS
from twin.studies.figure import GREY, INK, PAPER_BLUE, Axes, picture
from twin.studies.qualify.bench import Response
from twin.studies.qualify.comparison import COMPARED_MEASURES, FREE_RUN_MEASURES, DriveTrials
from twin.studies.qualify.definitions import (
    COMMAND_TIME,
    LOAD_IN_USE,
    LOAD_PEAK,
    LOAD_TIME,
    SPEED_IN_USE,
    TICK,
    Measure,
)
from twin.studies.qualify.motion import MIN_AMPLITUDE
from twin.studies.qualify.qualification import Qualification
from twin.studies.result import TEXT_WIDTH, Block, Column, Note, Result, Table, markdown

CHECK_COLUMNS = (Column("", 4, left=True), Column("", 10, left=True, gap=2), Column(folds=True))
MEASURE_COLUMNS = (Column("", 20, left=True), Column("", 10), Column("", 14, left=True), Column(folds=True))
DISPLAY_UNITS = {"s": (1e3, "ms"), "m": (1e3, "mm")}
"""SI unit -> (factor, display unit)."""

VALUE_ROUNDING = 1e-9
"""Rounding error of angles and speeds after seconds of turning, in SI units."""
MEASURE_HEADS = {
    "hold_error": "hold", "hold_overshoot": "over", "hold_settling_time": "settle", "chatter": "chatter",
    "held_lateral_error": "lateral", "held_z_error": "z", "current": "peak I", "shaft_work": "work", "energy": "energy",
}  # fmt: skip
DRIVE_MEASURES = ("current", "shaft_work", "energy", "cost")
PAIRED_COLUMNS = (Column("", 32, left=True), Column("difference", 44, left=True, gap=2))
COMMAND_COLOR, SPEED_COLOR, LOAD_COLOR, MARK_COLOR = GREY, PAPER_BLUE, "#c2571a", INK
TIME_BEFORE, TIME_AFTER = 0.02, 0.25
"""Time before and after a step that is shown (s)."""


def qualification_result(facts: dict[str, Any], references: str, picture: Path, holds: bool) -> Result:
    verdict = "QUALIFIED" if facts["qualified"] else "NOT QUALIFIED: " + ", ".join(facts["failed"])
    versions = " + ".join(fmu["standard"] for fmu in facts["fmus"])
    checks = [(check["verdict"], name, check["detail"]) for name, check in facts["checks"].items()]
    measures = [
        (one["text"], *_quantity(one["value"], one["unit"]), one["remark"]) for one in facts["measures"].values()
    ]
    body: list[Block] = [
        f"  {versions}, commanded with a {facts['command']}",
        "",
        Table(CHECK_COLUMNS, checks),
        "",
        Table(MEASURE_COLUMNS, measures),
        *(Note(f"warning: {warning}", later=2) for warning in facts["warnings"]),
        *([references] if references else []),
    ]
    met = facts["qualified"] and holds
    return Result(f"{facts['drive']}  {verdict}", body, facts, {"picture": picture}, label=8, exit_code=0 if met else 1)


def measures_table(checked: Sequence[Mapping[str, Any]]) -> str:
    measures = checked[0]["measures"].items()
    head = ["drive", *(f"{one['text']} ({_unit_in_table(one['unit'], name)})" for name, one in measures)]
    rows = []
    for facts in checked:
        drive = facts["drive"].removesuffix(".fmu") + ("" if facts["qualified"] else " (NOT qualified)")
        rows.append([drive, *(_table_cell(name, measure) for name, measure in facts["measures"].items())])
    return markdown(head, rows)


def compare_blocks(compared: DriveTrials) -> list[Block]:
    trials = compared.trials
    # The common table of measures takes precedence for work and energy, which have two definitions.
    measures = [
        {one.name: one for one in trial.measures}
        | {key: Measure(key, one.value, one.reason) for key, one in trial.done.measures.items()}
        for trial in trials
    ]
    held = any(its["hold_error"].value is not None for its in measures)
    tabled = dict.fromkeys([*(MEASURE_HEADS if held else FREE_RUN_MEASURES), *DRIVE_MEASURES])
    heads = {name: MEASURE_HEADS.get(name) or COMPARED_MEASURES[name].text for name in tabled}
    # A column without any value is replaced by a note.
    shown = {name: _unit_shown(name) for name in tabled if any(its[name].value is not None for its in measures)}
    columns = [Column(heads[name], max(6, len(heads[name]), len(unit)), unit=unit) for name, (_, unit) in shown.items()]
    first = TEXT_WIDTH - sum(1 + column.width for column in columns)
    rows = [
        [_shorten_name(trial.name, first - 1), *(_cell(its[name].value, shown[name][0]) for name in shown)]
        for trial, its in zip(trials, measures, strict=True)
    ]
    notes: dict[str, list[str]] = {}
    for trial, its in zip(trials, measures, strict=True):
        for name in tabled:
            if its[name].value is None and not trial.failure:
                notes.setdefault(f"{heads[name]}: {its[name].remark}", []).append(trial.name)
    differences: list[Block] = []
    for name, found in compared.differences().items():
        head = f"{name} less {trials[0].name}, {len(trials[0].repeats)} paired runs, mean and 95 % interval"
        lines = [(one.measure.text, f"{one.text}: {one.verdict}") for one in found]
        differences += ["", head, Table(PAIRED_COLUMNS, lines)]
    return [
        Table([Column("", first, left=True), *columns], rows, indent=0),
        *(Note(f"- {note} ({', '.join(names)})", later=2) for note, names in notes.items()),
        *(Note(f"FAILED {trial.name}: {trial.failure}", later=2) for trial in trials if trial.failure),
        *differences,
    ]


def shown_value(name: str, value: float) -> str:
    """Format a measure of compared drives in its display unit: `0.45 N`."""
    factor, unit = _unit_shown(name)
    return f"{_digits(value, factor)} {unit}"


def _quantity(value: float | None, unit: str) -> tuple[str, str]:
    factor, shown = DISPLAY_UNITS.get(unit, (1.0, unit))
    if value is not None and unit == "s" and abs(value) < 1e-3:
        factor, shown = 1e6, "us"
    return _digits(value, factor), "" if value is None else shown


def _digits(value: float | None, factor: float) -> str:
    """Format a value with three digits; rounding errors of zero are shown as 0."""
    if value is None:
        return "-"
    return "0" if abs(value) < VALUE_ROUNDING else format(factor * value, "#.3g").rstrip(".")


def _cell(value: float | None, factor: float) -> str:
    """Format a value in at most six characters, for narrow columns."""
    small = value is not None and abs(value) >= VALUE_ROUNDING and abs(factor * value) < 0.01
    return format(factor * (value or 0.0), ".4f") if small else _digits(value, factor)


def _unit_in_table(unit: str, name: str) -> str:
    return "us" if name == "cost" else DISPLAY_UNITS.get(unit, (1.0, unit))[1]


def _table_cell(name: str, measure: Mapping[str, Any]) -> str:
    factor = 1e6 if name == "cost" else DISPLAY_UNITS.get(measure["unit"], (1.0, ""))[0]
    if measure["value"] is None:
        return measure["remark"]
    return "0" if name == "droop" and measure["remark"] else _digits(measure["value"], factor)


def _unit_shown(name: str) -> tuple[float, str]:
    if name in MEASURES_OF_RUNS:
        unit = MEASURES_OF_RUNS[name].unit
        return unit.per_SI, unit.text
    if name == "cost":
        return 1e6, "us/tick"
    SI_unit = COMPARED_MEASURES[name].unit
    return (1.0, SI_unit) if name == "settling_time" else DISPLAY_UNITS.get(SI_unit, (1.0, SI_unit))


def _shorten_name(name: str, most: int) -> str:
    return name if len(name) <= most else "..." + name[-(most - 3) :]


def draw_drive_check(done: Qualification, path: Path) -> None:
    verdict = "qualified" if not done.failed_checks else "NOT qualified: " + ", ".join(done.failed_checks)
    with picture(path, 11, 7, f"{done.plan.label}   {verdict}") as figure:
        (a, b), (c, d) = figure.subplots(2, 2)
        curves = done.curves
        if curves.cycle is not None:
            _draw_step(a, done, curves.cycle)
            _draw_load_step(b, curves.cycle)
        if len(curves.frequencies):
            _draw_frequency_response(c, done)
        if curves.overload is not None:
            _draw_overload(d, done, curves.overload)
        titles = ("Step of the command", f"Step of the load to {LOAD_IN_USE:g} N m", "Small signals", "Growing load")
        for axes, title in zip((a, b, c, d), titles, strict=True):
            axes.set_title(title, loc="left")
            if not axes.has_data():
                axes.text(0.5, 0.5, "the drive failed", ha="center", va="center", transform=axes.transAxes)


def _draw_step(axes: Axes, done: Qualification, cycle: Response) -> None:
    part = cycle.window(COMMAND_TIME - TIME_BEFORE, COMMAND_TIME + TIME_AFTER)
    t = 1e3 * (cycle.t[part] - COMMAND_TIME)
    axes.plot(t, cycle.omega_ref[part], color=COMMAND_COLOR, lw=1.2, drawstyle="steps-post", label="command")
    axes.plot(t, cycle.omega_m[part], color=SPEED_COLOR, lw=1.6, label="speed")
    final = done.value("speed") or 0.0
    axes.axhspan(
        (1.0 - SETTLING_BAND) * final, (1.0 + SETTLING_BAND) * final, color=SPEED_COLOR, alpha=0.10, lw=0, label="±5 %"
    )
    settled = done.value("settling_time")
    if settled is not None and settled < TIME_AFTER:
        axes.axvline(1e3 * settled, color=MARK_COLOR, lw=0.9, ls=":", label=f"settled, {1e3 * settled:.0f} ms")
    axes.set(xlabel="time after the step (ms)", ylabel="motor speed (rad/s)")
    axes.legend(loc="lower right")


def _draw_load_step(axes: Axes, cycle: Response) -> None:
    part = cycle.window(LOAD_TIME - TIME_BEFORE, LOAD_TIME + TIME_AFTER)
    t = 1e3 * (cycle.t[part] - LOAD_TIME)
    axes.plot(t, cycle.omega_ref[part], color=COMMAND_COLOR, lw=1.2, label="command")
    axes.plot(t, cycle.omega_m[part], color=SPEED_COLOR, lw=1.6, label="speed")
    # A stiff drive would otherwise be drawn at the scale of rounding errors.
    low, high = axes.get_ylim()
    axes.set_ylim(min(low, SPEED_IN_USE - 0.1), max(high, SPEED_IN_USE + 0.05))
    axes.axvline(0.0, color=LOAD_COLOR, lw=0.9, ls=":", label="load comes on")
    axes.set(xlabel="time after the step (ms)", ylabel="motor speed (rad/s)")
    axes.legend(loc="lower right")


def _draw_frequency_response(axes: Axes, done: Qualification) -> None:
    f, gain = done.curves.frequencies, done.curves.gain
    if not gain[0] > 0.0:
        axes.text(0.5, 0.5, "it does not follow its command", ha="center", va="center", transform=axes.transAxes)
        return
    decibel = 20.0 * np.log10(np.maximum(gain / gain[0], MIN_AMPLITUDE))
    axes.semilogx(f, decibel, color=SPEED_COLOR, lw=1.6, marker="o", ms=3)
    axes.axhline(-3.0, color=MARK_COLOR, lw=0.9, ls=":")
    bandwidth = done.value("bandwidth")
    if bandwidth is not None:
        axes.axvline(bandwidth, color=MARK_COLOR, lw=0.9, ls=":")
        label = f"-3 dB at {bandwidth:.3g} Hz"
        axes.annotate(label, (bandwidth, -3.0), (-8, -12), textcoords="offset points", ha="right", va="top")
    axes.set_ylim(max(-40.0, min(-12.0, float(np.min(decibel)) - 2.0)), max(6.0, float(np.max(decibel)) + 2.0))
    axes.xaxis.set_major_formatter("{x:g}")
    axes.set(xlabel="frequency (Hz)", ylabel="speed over command (dB)")


def _draw_overload(axes: Axes, done: Qualification, overload: Response) -> None:
    n = round(0.05 / TICK)
    speed = (overload.theta_m[n:] - overload.theta_m[:-n]) / (n * TICK)
    load = overload.tau_load[n // 2 : n // 2 + len(speed)]
    axes.plot(load, speed, color=SPEED_COLOR, lw=1.4, label="speed, mean of 50 ms")
    axes.axvspan(0.0, LOAD_IN_USE, color=COMMAND_COLOR, alpha=0.15, lw=0, label="in use")
    axes.axvline(LOAD_PEAK, color=COMMAND_COLOR, lw=0.9, ls="--", label=f"peak, {LOAD_PEAK:g} N m")
    stall = done.value("stall_torque")
    if stall is not None:
        axes.axvline(stall, color=MARK_COLOR, lw=0.9, ls=":", label=f"stall, {stall:.3g} N m")
    axes.set_ylim(-0.3 * SPEED_IN_USE, 1.6 * SPEED_IN_USE)
    axes.set_xlim(0.0, max(1.1 * LOAD_PEAK, 1.1 * (stall or float(load[-1]))))
    axes.set(xlabel="load (N m)", ylabel="motor speed (rad/s)")
    axes.legend(frameon=True, edgecolor="none", framealpha=0.9, loc="lower left")
