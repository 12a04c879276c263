"""A replay as text of at most 80 columns: the verdict first, then why, then where the files are."""

from collections.abc import Mapping
from dataclasses import asdict
from enum import StrEnum
from math import degrees, isnan

from twin.studies.lines import labelled, wrapped
from twin.studies.replay.replay import Indicator, Replay
from twin.writing import finite

ROWS = {"estimator": "estimate", "twin": "dead zone off", "plant": "plant model"}


class ReplayVerdict(StrEnum):
    """What a replay comes to."""

    MATCHES = "matches"
    DRIFTING = "drifting"
    UNKNOWN = "cannot tell"


def verdict(replay: Replay) -> ReplayVerdict:
    """Of all indicators; without one nothing can be said."""
    if not replay.indicators:
        return ReplayVerdict.UNKNOWN
    return ReplayVerdict.DRIFTING if replay.first_alarm else ReplayVerdict.MATCHES


def replay_text(replay: Replay, name: str, files: Mapping[str, str], following: str) -> str:
    """The whole report. name: of the log; files: kind -> path; following: the command that comes next, or ""."""
    lines = [_headline(replay, name), *_reasons(replay), ""]
    if replay.forces:
        lines += [*_table(replay), ""]
    lines += _samples(replay)
    lines += [f"  {kind:<10} {path}" for kind, path in files.items()]
    lines += [f"  {'next':<10} {following}"] if following else []
    return "\n".join(lines)


def _headline(replay: Replay, name: str) -> str:
    match verdict(replay):
        case ReplayVerdict.MATCHES:
            return f"{name}: robot and twin match, {replay.log.t[0]:g} to {replay.log.t[-1]:g} s"
        case ReplayVerdict.UNKNOWN:
            return f"{name}: cannot tell whether robot and twin match"
    first = replay.first_alarm
    assert first is not None
    return f"{name}: robot and twin part since {first.drift.since:.3f} s\n  {_change(first)}"


def _change(one: Indicator) -> str:
    side = "above" if one.drift.size > 0 else "below"
    if one.name == "force":
        return f"the force estimate went {abs(one.drift.size):.2f} N {side} the measured force"
    return f"{one.name} of the plant model went {abs(degrees(one.drift.size)):.3f} deg {side} the robot's"


def _reasons(replay: Replay) -> list[str]:
    told = []
    if replay.indicators:
        told += ["", f"  {'block means':<11} {'seen above':>11} {'largest':>11}   verdict"]
    for one in replay.indicators:
        d = one.drift
        scale, unit = (1.0, "N") if one.unit == "N" else (degrees(1.0), "deg")
        largest, slack = f"{scale * max(abs(d.mean - d.baseline)):.3f} {unit}", f"{scale * d.slack:.3f} {unit}"
        found = "matches" if d.matches else f"since {d.since:.3f} s, seen at {d.alarm:.3f} s"
        told.append(f"  {one.name:<11} {slack:>11} {largest:>11}   {found}")
    if replay.first_alarm:
        told += wrapped(
            "A spring, belt, encoder, the body or the force sensor has changed; this cannot tell which.", "  "
        )
    if not replay.indicators and replay.log.force is not None:
        return wrapped("The log ends before one block of 1 s after the baseline.", "  ")
    if replay.log.force is None:
        told += wrapped(
            "No force was measured, and the estimate comes from the encoders alone: if k_s is not what the twin "
            "believes, it is wrong by that share and nothing contradicts it. Name a measured force with "
            "--map scale.F_z=COLUMN[N]" + ("." if replay.plant else ", or let the plant model run with --plant."),
            "  ",
            whole=True,
        )
    return told


def _table(replay: Replay) -> list[str]:
    rows = [
        f"  F_z less measured {'bias':>8} {'std':>7} {'rms':>7} {'largest':>9} {'at':>9}   corr.    lag",
        f"  {'':<17} {'N':>8} {'N':>7} {'N':>7} {'N':>9} {'s':>9}       1     ms",
    ]
    for name, s in replay.statistics.items():
        rows.append(
            f"  {ROWS[name]:<17} {s.bias:>+8.3f} {s.std:>7.3f} {s.rms:>7.3f} {s.largest:>+9.3f} {s.at:>9.3f} "
            f"{_or_dash(s.correlation, '7.4f'):>7} {_or_dash(1e3 * s.lag, '6.0f'):>6}"
        )
    return rows


def _or_dash(value: float, form: str) -> str:
    return "-" if isnan(value) else format(value, form)


def _samples(replay: Replay) -> list[str]:
    log = replay.log
    lost = f"{log.missing} missing in {len(log.gaps)} gaps" if len(log.gaps) else "none missing"
    told = labelled("samples", f"{len(log.t)}, one every {1e3 * log.period:.4g} ms, {lost}")
    if len(replay.starts) > 1:
        again = ", ".join(f"{start:.3f}" for start in replay.starts[1:])
        told += labelled("restarts", f"the plant model starts anew after gaps, at {again} s")
    for note in log.notes:
        told += labelled("note", note, whole=True)
    return told


def next_command(replay: Replay, log: str) -> list[str]:
    """What finds out which part has changed, or, without a measured force, whether one has; then nothing."""
    if replay.log.force is not None:
        return ["twin", "identify", log]
    return [] if replay.plant else ["twin", "replay", log, "--plant"]


def replay_facts(replay: Replay) -> dict[str, object]:
    """Everything that a replay says in numbers; keys carry units, what does not exist is None."""
    log = replay.log
    return {
        "log": log.path.name,
        "experiment": replay.model.name,
        "verdict": verdict(replay).value,
        "start_s": float(log.t[0]),
        "end_s": float(log.t[-1]),
        "samples": len(log.t),
        "missing": log.missing,
        "gaps_s": log.gaps.tolist(),
        "force_N": {name: finite(asdict(one)) for name, one in replay.statistics.items()},
        "indicators": [_indicator_facts(one) for one in replay.indicators],
        "notes": list(log.notes),
    }


def _indicator_facts(one: Indicator) -> dict[str, object]:
    d = one.drift
    return finite(
        {
            "name": one.name, "unit": one.unit, "matches": d.matches, "since_s": d.since, "alarm_s": d.alarm,
            "size": d.size, "baseline": d.baseline, "sigma": d.sigma, "tolerance": d.tolerance, "slack": d.slack,
            "threshold": d.threshold, "block_s": d.block,
        }
    )  # fmt: skip
