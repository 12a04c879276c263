"""Report of a replay: text of at most 80 columns, facts, and a picture."""

from math import degrees
from pathlib import Path

import numpy as np

from twin.kernel.serialise import to_dict
from twin.robot.run.measures import Values, with_units
from twin.studies.figure import INK, JOINT_COLORS, PAPER_BLUE, PAPER_ORANGE, PAPER_YELLOW, RED, Axes, picture
from twin.studies.replay.held import measures_text
from twin.studies.replay.parts import pressing
from twin.studies.replay.replay import Indicator, Replay
from twin.studies.result import Block, Column, Note, Result, Table, note

FORCE_ROWS = {"estimator": "estimate", "twin": "dead zone off", "plant": "plant model"}
INDICATOR_COLUMNS = (
    Column("block means", 11, left=True),
    Column("seen above", 11),
    Column("largest", 11),
    Column("verdict", left=True, gap=3),
)
STATISTICS_COLUMNS = (
    Column("F_z less measured", 17, left=True),
    Column("bias", 8, "+.3f", "N"),
    Column("std", 7, ".3f", "N"),
    Column("rms", 7, ".3f", "N"),
    Column("largest", 9, "+.3f", "N"),
    Column("at", 9, ".3f", "s"),
    Column("corr.", 7, ".4f", "1"),
    Column("lag", 6, ".0f", "ms"),
)
MEASURED_COLOR, ESTIMATE_COLOR, TWIN_COLOR, PLANT_COLOR, ALARM_COLOR = INK, PAPER_YELLOW, PAPER_ORANGE, PAPER_BLUE, RED


def replay_result(replay: Replay, held: Values, name: str, files: dict[str, str], following: str) -> Result:
    """Create the report of a replay; `files`: kind -> path; `following`: command to run next, or ""."""
    forces: list[Block] = [_table(replay), ""] if replay.forces else []
    parts = [*_reasons(replay), "", *forces, note("held", measures_text(held)), *_samples(replay)]
    shown = {**files, **({"next": following} if following else {})}
    facts = replay_facts(replay, held) | files | {"next": following}
    return Result(_headline(replay, name), parts, facts, shown, exit_code=1 if replay.first_alarm else 0)


def _headline(replay: Replay, name: str) -> str:
    if first := replay.first_alarm:
        return f"{name}: robot and twin diverge since {first.drift.since:.3f} s\n  {_change(first)}"
    if replay.indicators:
        return f"{name}: robot and twin match, {replay.log.t[0]:g} to {replay.log.t[-1]:g} s"
    return f"{name}: cannot tell whether robot and twin match"


def _change(one: Indicator) -> str:
    side = "above" if one.drift.size > 0 else "below"
    if one.name == "force":
        return f"the force estimate went {abs(one.drift.size):.2f} N {side} the measured force"
    return f"{one.name} of the plant model went {abs(degrees(one.drift.size)):.3f} deg {side} the robot's"


def _reasons(replay: Replay) -> list[Block]:
    blocks: list[Block] = []
    if replay.indicators:
        blocks += ["", Table(INDICATOR_COLUMNS, [_indicator(one) for one in replay.indicators])]
    if replay.first_alarm:
        blocks.append(
            Note("A spring, belt, encoder, the body or the force sensor has changed; this cannot tell which.", "  ")
        )
    if not replay.indicators and replay.log.force is not None:
        return [Note("The log ends before one block of 1 s after the baseline.", "  ")]
    if replay.log.force is None:
        text = (
            "No force was measured, and the estimate comes from the encoders alone: if k_s is not what the twin "
            "believes, it is wrong by that share and nothing contradicts it. Name a measured force with "
            "--map scale.F_z=COLUMN[N]" + ("." if replay.plant else ", or let the plant model run with --plant.")
        )
        blocks.append(Note(text, "  ", whole=True))
    return blocks


def _indicator(one: Indicator) -> list[str]:
    d = one.drift
    scale, unit = (1.0, "N") if one.unit == "N" else (degrees(1.0), "deg")
    found = "matches" if d.matches else f"since {d.since:.3f} s, seen at {d.alarm:.3f} s"
    return [one.name, f"{scale * d.slack:.3f} {unit}", f"{scale * max(abs(d.mean - d.baseline)):.3f} {unit}", found]


def _table(replay: Replay) -> Table:
    rows = [
        (FORCE_ROWS[name], s.bias, s.std, s.rms, s.largest, s.at, s.correlation, 1e3 * s.lag)
        for name, s in replay.statistics.items()
    ]
    return Table(STATISTICS_COLUMNS, rows)


def _samples(replay: Replay) -> list[Block]:
    log = replay.log
    gaps = len(log.sampling.gaps)
    lost = f"{log.sampling.missing} missing in {gaps} gaps" if gaps else "none missing"
    again = ", ".join(f"{start:.3f}" for start in replay.starts[1:])
    return [
        note("samples", f"{len(log.t)}, one every {1e3 * log.sampling.period:.4g} ms, {lost}"),
        *([note("restarts", f"the plant model restarts after gaps, at {again} s")] if again else []),
        *(note("note", text, whole=True) for text in log.notes),
    ]


def next_command(replay: Replay, log: str) -> list[str]:
    """Return the command to run next on a log to find the changed part, or the change; empty after the plant model."""
    if replay.log.force is not None:
        return ["twin", "identify", log]
    return [] if replay.plant else ["twin", "replay", log, "--plant"]


def replay_facts(replay: Replay, held: Values) -> dict[str, object]:
    """Convert all results of a replay to numbers; keys carry units, missing values are None."""
    log, tested = replay.log, "matches" if replay.indicators else "cannot tell"
    return {
        "log": log.path.name,
        "experiment": replay.model.name,
        "verdict": "drifting" if replay.first_alarm else tested,
        "start_s": float(log.t[0]),
        "end_s": float(log.t[-1]),
        "samples": len(log.t),
        "missing": log.sampling.missing,
        "gaps_s": log.sampling.gaps.tolist(),
        "force_N": {name: to_dict(one) for name, one in replay.statistics.items()},
        "indicators": to_dict(replay.indicators),
        "measures": with_units(held),
        "notes": list(log.notes),
    }


def draw_replay(replay: Replay, name: str, path: Path) -> None:
    kinds = [[one for one in replay.indicators if one.unit == unit] for unit in ("N", "rad")]
    tested = [kind for kind in kinds if kind]
    panels = 1 + len(tested) + bool(tested)
    with picture(path, 11, 1.2 + 2.3 * panels) as figure:
        axes = list(np.atleast_1d(figure.subplots(panels, 1, sharex=True)))
        _draw_forces(axes[0], replay)
        for panel, alike in zip(axes[1:], tested, strict=False):
            _draw_residuals(panel, alike)
        if tested:
            _draw_sums(axes[-1], replay.indicators)
        first = replay.first_alarm
        for panel in axes:
            panel.margins(x=0)
            for start, end in replay.log.sampling.gaps:
                panel.axvspan(start, end, color="0.9")
            if first is not None:
                panel.axvspan(first.drift.since, replay.log.t[-1], color=ALARM_COLOR, alpha=0.06)
                panel.axvline(first.drift.alarm, color=ALARM_COLOR, lw=1.0)
        axes[0].set_title(_title(replay, name), loc="left", fontweight="bold")
        axes[-1].set_xlabel("time (s)")


def _title(replay: Replay, name: str) -> str:
    first = replay.first_alarm
    if first is not None:
        return f"{name}: robot and twin diverge since {first.drift.since:.1f} s ({first.name})"
    return f"{name}: " + ("robot and twin match" if replay.indicators else "nothing to compare the estimate with")


def _draw_forces(axes: Axes, replay: Replay) -> None:
    t = replay.log.t
    axes.plot(t, pressing(replay.estimator), color=ESTIMATE_COLOR, lw=0.9, label="estimate")
    if replay.twin is not replay.estimator:
        axes.plot(t, pressing(replay.twin), color=TWIN_COLOR, lw=0.9, label="estimate, dead zone taken off")
    if replay.plant is not None:
        axes.plot(t, pressing(replay.plant), color=PLANT_COLOR, lw=1.2, label="plant model")
    if replay.log.force is not None:
        force = replay.log.force
        axes.step(force.t, force.values, where="post", color=MEASURED_COLOR, lw=1.0, label="measured")
    axes.set_ylabel("F_z, pressing (N)")
    axes.legend(loc="best", fontsize="small")


def _color(one: Indicator) -> str:
    return TWIN_COLOR if one.unit == "N" else JOINT_COLORS[int(one.name[-1]) - 1]


def _draw_residuals(axes: Axes, alike: list[Indicator]) -> None:
    """Draw the residual of the force, or the residuals of all joints."""
    for one in alike:
        if one.unit == "N":
            _draw_residual(axes, one, 1.0, "estimate, dead zone taken off, less measured: means of blocks")
        else:
            _draw_residual(axes, one, degrees(1.0), f"{one.name}, model less robot")
    axes.set_ylabel("force residual (N)" if alike[0].unit == "N" else "joint residual (deg)")
    axes.legend(loc="best", fontsize="small", ncols=len(alike))


def _draw_residual(axes: Axes, one: Indicator, scale: float, label: str) -> None:
    """Draw the samples and block means of a residual, and the band without growth of the sums."""
    d, color = one.drift, _color(one)
    axes.plot(one.t, scale * one.r, color=color, lw=0.5, alpha=0.3)
    edges = np.concatenate([[d.t[0] - d.block], d.t])
    axes.stairs(scale * d.mean, edges, color=color, lw=1.8, baseline=None, label=label)
    for side in (-1.0, 1.0):
        named = "no sum fills in here" if side > 0 and one.name in ("force", "joint 1") else None
        axes.axhline(scale * (d.baseline + side * d.slack), color="0.5", lw=0.8, ls="--", label=named)
    # scale by the means, since single samples may be far off
    reach = scale * max(3.0 * d.slack, 1.3 * float(np.max(np.abs(d.mean - d.baseline))))
    low, high = axes.get_ylim() if axes.has_data() and axes.lines else (0.0, 0.0)
    middle = scale * d.baseline
    axes.set_ylim(
        min(middle - reach, max(low, middle - 2.0 * reach)), max(middle + reach, min(high, middle + 2.0 * reach))
    )


def _draw_sums(axes: Axes, indicators: tuple[Indicator, ...]) -> None:
    for one in indicators:
        d = one.drift
        worst = np.where(d.up >= d.low, d.up, -d.low) / d.threshold
        axes.plot(d.t, worst, marker=".", lw=1.2, color=_color(one), label=one.name)
    for side in (-1.0, 1.0):
        axes.axhline(side, color=ALARM_COLOR, lw=0.9, ls="--", label="alarm" if side > 0 else None)
    axes.set_ylabel("cumulative sum / H")
    low, high = axes.get_ylim()
    axes.set_ylim(max(min(low, -1.4), -4.0), min(max(high, 1.4), 4.0))
    axes.legend(loc="best", fontsize="small", ncols=4)
