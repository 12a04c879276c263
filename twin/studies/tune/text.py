"""The result of tuning as text of at most 80 columns, as an experiment file and as a picture."""

import math
import shlex
from collections.abc import Iterator, Sequence
from pathlib import Path
from typing import Any

import numpy as np
import tomlkit

from twin.kernel.atomic_write import inline_table
from twin.robot.run.measures import ROWS_BY_KEY
from twin.robot.run.runs import Outcome
from twin.studies.figure import BARE_STYLE, BLUE, GREY, Axes, picture
from twin.studies.result import Block, Column, Note, Row, Table
from twin.studies.tune.prediction import SETTLED_BAND, STEP_HORIZON, StepAnswer, sensitivities, step_response
from twin.studies.tune.touchdown import (
    HOLD_ERROR,
    HOLD_OVERSHOOT,
    HOLD_SETTLING,
    JUDGED_MEASURES,
    NONE_TEXT,
    measure_text,
)
from twin.studies.tune.tuned import GainAssessment, Miss, TuningResult, worst_places

MAX_MODEL_ERROR = 0.03
"""Relative error of a drive's linear model against its measured response above which it is reported."""
UNTRIED_NOTE = "no step is simulated: tasks lead this robot, and damping that only they have acts"
STEP_HEAD = f"{'M_s':>4} {'over':>5} {'5 % in':>7} {'-3 dB':>7}"
RUN_HEAD = f"{'over':>6} {'5 % in':>7} {'hold error':>11}"
BEFORE_COLOR, AFTER_COLOR, PALE_COLOR = GREY, BLUE, "#d9d9d9"
MAX_PANEL_COLUMNS = 4
FREQUENCY_RANGE = (0.02, 200.0)
"""Frequency range of the sensitivity plots (Hz)."""


def goals_sentence(done: TuningResult) -> str:
    """Summarise tuning goals: `M_s at most 1.6, steps overshoot at most 5 %, on 300 to 5000 N/m, ...`."""
    goals = done.goals
    parts = [f"M_s at most {goals.sensitivity:g}", f"steps overshoot at most {100.0 * goals.overshoot:g} %"]
    if goals.bandwidth is not None:
        parts.append(f"{goals.law} bandwidth at least {goals.bandwidth_hertz:g} Hz")
    if done.stiffness is not None:
        parts.append("on {:g} to {:g} N/m".format(*done.stiffness))
    parts.append("with " + " and ".join(Path(drive.labels[0]).stem for drive in done.drives))
    if goals.law == "force":
        parts.append(f"the experiment itself overshoots at most {100.0 * goals.overshoot:g} %")
    return ", ".join(parts)


def fragment(done: TuningResult, experiment: Path, folder: Path, options: Sequence[str]) -> str:
    """Return the TOML file in `folder` with the tuned gains, and `options` in its comment, extending an experiment."""
    source = f"twin tune: {goals_sentence(done)}" + ("" if done.meets_goals else "; GOALS NOT MET")

    def gain_value(value: float, before: float) -> Any:
        # Six digits exceed the precision of the search.
        return inline_table({"value": float(f"{value:.6g}"), "source": f"{source}; was {before:.6g}"})

    before, after = done.before.gains, done.after.gains
    laws = {"position": {"kp_per_s": gain_value(after.kp, before.kp), "ki_per_s2": 0, "kd": 0}}
    if done.goals.law == "force":
        laws["force"] = {
            "kp_mm_per_N": gain_value(1e3 * after.force_kp, 1e3 * before.force_kp),
            "ki_mm_per_N_s": gain_value(1e3 * after.force_ki, 1e3 * before.force_ki),
            "kd_mm_s_per_N": 0,
        }
    head = f"# twin tune {shlex.join([str(experiment), *options])}: {goals_sentence(done)}\n"
    return head + tomlkit.dumps({"extends": str(findable_path(experiment, folder)), "controller": laws})


def findable_path(experiment: Path, folder: Path) -> Path:
    """Return an experiment's path as typed if it is found from another folder or its parents, else absolute."""
    here, file = folder.resolve(), experiment.resolve()
    found = next((place / experiment for place in (here, *here.parents) if (place / experiment).exists()), None)
    return experiment if found is not None and found.resolve() == file else file


def _columns(name: str, head: str) -> tuple[Column, ...]:
    two = (Column(f"{when:-^26}", 26, unit=head, left=True, gap=2) for when in ("before", "after"))
    return Column("", 23, unit=name, left=True), *two


def tuning_parts(done: TuningResult) -> list[Block]:
    doubtful = [
        f"the linear model of {drive.labels[0]} is {100.0 * model.residual:.2g} % off its measured response; "
        "trust the simulation"
        for drive in done.drives
        if (model := drive.drives[0]).turning or model.residual > MAX_MODEL_ERROR
    ]
    untried = [] if done.after.trials else [UNTRIED_NOTE]
    return [
        *_verdict(done),
        "",
        _gains(done),
        Note(goals_sentence(done), "  goals     "),
        "",
        Table(_columns("a step of", STEP_HEAD), list(_steps(done)), indent=0),
        "",
        *_runs(done),
        *(Note(text, "note  ") for text in (*doubtful, *untried, *(f"left out: {one}" for one in done.problems))),
    ]


def _verdict(done: TuningResult) -> list[Block]:
    name, corners = done.experiments[0].name, len(done.after.predictions)
    if done.meets_goals:
        confirmed = ", and the co-simulation agrees" if done.after.trials else ""
        where = "the one corner" if corners == 1 else f"all {corners} corners"
        remark = ["  no gains better than the file's were found"] if done.after.gains == done.before.gains else []
        return [f"{name}  GOALS MET at {where}{confirmed}", *remark, *_overshoot_notes(done)]
    missed = [*(_miss(done, miss) for miss in done.after.misses), *done.contradictions]
    return [f"{name}  GOALS NOT MET; this is the best that was found", *map(missed_note, missed)]


def _overshoot_notes(done: TuningResult) -> Iterator[Note]:
    """Yield a note for each touch-down that overshoots by more than the goal for the experiment itself."""
    for where, before, after in zip(done.surfaces, done.before.wholes, done.after.wholes, strict=True):
        was, now = (one.measures[HOLD_OVERSHOOT].value for one in (before, after))
        if now is not None and was is not None and now > done.goals.overshoot:
            shown = ROWS_BY_KEY[HOLD_OVERSHOOT].format_value
            yield Note(f"{where.name} overshoots by {shown(now)}; it was {shown(was)}", "  but       ")


def missed_note(text: str) -> Note:
    return Note(text, "  missed    ")


def _miss(done: TuningResult, miss: Miss) -> str:
    where = f"{miss.at.corner.name} with {Path(miss.at.corner.drive).stem}"
    goals = done.goals
    if miss.goal == "stability":
        return f"no gains found that are stable: {where}"
    if miss.goal == "margin":
        return f"M_s at most {goals.sensitivity:g}: it is {miss.reached:.3g}, {where}"
    if miss.goal == "overshoot":
        return f"overshoot at most {100 * goals.overshoot:g} %: it is {100 * miss.reached:.2g} %, {where}"
    reached = miss.reached / (2.0 * math.pi)
    return f"bandwidth at least {goals.bandwidth_hertz:g} Hz: it is {reached:.3g} Hz, {where}; margin goes first"


def _gains(done: TuningResult) -> Table:
    before, after = done.before.gains, done.after.gains
    rows = [("position", f"kp = {after.kp:.3g} 1/s", f"was {before.kp:.3g}")]
    if done.goals.law == "force":
        rows += [
            ("force", f"kp = {1e3 * after.force_kp:.3g} mm/N", f"was {1e3 * before.force_kp:.3g}"),
            ("", f"ki = {1e3 * after.force_ki:.3g} mm/(N s)", f"was {1e3 * before.force_ki:.3g}"),
        ]
    return Table((Column("", 8, left=True), Column("", 24, left=True, gap=2), Column(left=True)), rows)


def _steps(done: TuningResult) -> Iterator[Row]:
    drive = ""
    for i in worst_places(done.after.predictions):
        corner = done.after.predictions[i].corner
        if corner.drive != drive:
            drive = corner.drive
            yield Path(drive).stem
        yield f"  {corner.name}", _prediction_text(done.before, i), _prediction_text(done.after, i)
        if i in done.after.trials:
            yield "    simulated", _trial_text(done.before, i), _trial_text(done.after, i)


def _prediction_text(judged: GainAssessment, i: int) -> str:
    prediction = judged.predictions[i]
    found = prediction.answer
    if found is None:
        return f"{'UNSTABLE':^26}"
    return f"{prediction.sensitivity:#4.3g} {_answer(found)} {_bandwidth(found.bandwidth)}"


def _trial_text(judged: GainAssessment, i: int) -> str:
    trial = judged.trials.get(i)
    if trial is None:
        return f"{'failed' if i in judged.trials else 'not tried':^26}"
    return f"{'':4} {_answer(trial.answer)} {_bandwidth(trial.answer.bandwidth)}"


def _bandwidth(omega: float) -> str:
    hertz = omega / (2.0 * math.pi)
    digits = 2 if hertz < 1.0 else 1 if hertz < 10.0 else 0
    return f"{'-':>7}" if math.isnan(omega) else f"{hertz:4.{digits}f} Hz"


def _answer(found: StepAnswer) -> str:
    settling = f"{found.settling:.2f} s" if math.isfinite(found.settling) else f"> {STEP_HORIZON:g} s"
    return f"{100.0 * found.overshoot:3.0f} % {settling:>7}"


def _runs(done: TuningResult) -> Iterator[Block]:
    runs = list(zip(done.surfaces, done.before.wholes, done.after.wholes, strict=True))
    if all(one.measures[HOLD_ERROR].value is None for one in (*done.before.wholes, *done.after.wholes)):
        for where, before, after in runs:
            if where.stiffness is None:
                text = f"z off by {_z_error(before)} before, {_z_error(after)} after (rms)"
                yield Note(f"the experiment itself, {Path(where.drive).stem}: {text}", "run   ")
        return
    rows: list[Row] = []
    for where, before, after in runs:
        place = f"  on {where.stiffness:.4g} N/m" if where.stiffness else "  as in its file"
        rows += [Path(where.drive).stem] if where.stiffness is None else []
        rows.append((place, _touch_down(before), _touch_down(after)))
    yield from (Table(_columns("the experiment", RUN_HEAD), rows, indent=0), "")
    # The missing measures of the last run stand for all.
    missing = (key for key in JUDGED_MEASURES if after.numbers and measure_text(after, key) == NONE_TEXT)
    yield from (Note(f"no {ROWS_BY_KEY[key].text}: {after.measures[key].reason}", "note  ") for key in missing)


def _touch_down(done: Outcome) -> str:
    if done.status != "done":
        return f"{'safety trip' if done.status == 'tripped' else 'failed':^26}"
    overshoot, settling = measure_text(done, HOLD_OVERSHOOT), measure_text(done, HOLD_SETTLING)
    return f"{overshoot:>6} {settling:>7} {measure_text(done, HOLD_ERROR):>11}"


def _z_error(done: Outcome) -> str:
    if done.numbers is None:
        return "it failed"
    assert done.numbers.z_error is not None, "twin's own controller has a reference"
    return f"{1e3 * done.numbers.z_error:.2g} mm" + (" and a safety trip" if done.status == "tripped" else "")


def draw_tuning(done: TuningResult, path: Path) -> None:
    shown = worst_places(done.after.predictions)
    columns = min(MAX_PANEL_COLUMNS, len(shown))
    rows = -(-len(shown) // columns)
    title = f"{done.experiments[0].name}, tuned: {'goals met' if done.meets_goals else 'GOALS NOT MET'}"
    with picture(path, 3.4 * max(columns, 2), 4.6 * rows + 0.9, title, look=BARE_STYLE) as figure:
        grid = figure.subplots(2 * rows, columns, squeeze=False, height_ratios=[1.3, 1.0] * rows)
        for axes in grid.flat:
            axes.set_axis_off()
        for k, i in enumerate(shown):
            row, column = 2 * (k // columns), k % columns
            _draw_steps(grid[row, column], done, i)
            _draw_sensitivity(grid[row + 1, column], done, i)
            for axes, label in zip(grid[row : row + 2, 0], ("share of the step", "largest |1/(1+L)|"), strict=True):
                axes.set_ylabel(label, fontsize=8)
        # Panels without a trial, or with an unstable loop, have fewer legend entries.
        handles, labels = max((axes.get_legend_handles_labels() for axes in grid.flat), key=lambda found: len(found[1]))
        figure.legend(handles, labels, loc="outside lower center", ncols=4, fontsize=9)


def _draw_steps(axes: Axes, done: TuningResult, i: int) -> None:
    corner, top = done.after.predictions[i].corner, 1.0 + done.goals.overshoot
    _draw(axes, done.before, i, BEFORE_COLOR, "before")
    _draw(axes, done.after, i, AFTER_COLOR, "after")
    axes.axhspan(1.0 - SETTLED_BAND, 1.0 + SETTLED_BAND, color=PALE_COLOR, lw=0, zorder=0)
    axes.axhline(top, color=PALE_COLOR, lw=0.8)
    axes.set(xlim=(0.0, _span(done.after, i)), ylim=(-0.1, max(1.3, top + 0.1)))
    axes.set_title(f"{corner.name}\n{Path(corner.drive).stem}", loc="left", fontsize=9)
    _label_axes(axes, "time since the step (s)")


def _draw_sensitivity(axes: Axes, done: TuningResult, i: int) -> None:
    """Draw the predicted sensitivity at a corner, the largest over all loops, and its goal."""
    for judged, color in ((done.before, BEFORE_COLOR), (done.after, AFTER_COLOR)):
        prediction = judged.predictions[i]
        if prediction.stable:
            S = np.abs(sensitivities(prediction.corner, judged.gains)).max(axis=1)
            axes.semilogx(prediction.corner.omega / (2.0 * np.pi), S, color=color, lw=1.3, ls="--")
    axes.axhline(done.goals.sensitivity, color=PALE_COLOR, lw=0.8)
    axes.text(FREQUENCY_RANGE[0], done.goals.sensitivity, " asked", fontsize=7, color=BEFORE_COLOR, va="bottom")
    axes.set(xlim=FREQUENCY_RANGE, ylim=(0.0, max(2.0, 1.2 * done.goals.sensitivity)))
    _label_axes(axes, "frequency (Hz)")


def _label_axes(axes: Axes, label: str) -> None:
    axes.set_axis_on()
    axes.set_xlabel(label, fontsize=8)
    axes.tick_params(labelsize=8)


def _draw(axes: Axes, judged: GainAssessment, i: int, color: str, name: str) -> None:
    prediction, trial = judged.predictions[i], judged.trials.get(i)
    if trial is not None:
        axes.plot(trial.t, trial.share, color=color, lw=0.9, alpha=0.6, label=f"{name}, simulated")
    if prediction.stable:
        t, y, final = step_response(prediction.corner, judged.gains, prediction.corner.axes[-1])
        axes.plot(t, y / final, color=color, lw=1.3, ls="--", label=f"{name}, predicted")


def _span(judged: GainAssessment, i: int) -> float:
    """Return the time span (s) of a step response to plot: the step and some time at rest after it."""
    found = judged.predictions[i].answer
    if found is None or not math.isfinite(found.settling):
        return STEP_HORIZON
    return float(np.clip(4.0 * found.settling, 0.5, STEP_HORIZON))
