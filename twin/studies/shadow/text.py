"""Summary of a session with a robot: text of at most 80 columns, and facts."""

import math
from collections.abc import Mapping
from dataclasses import asdict
from pathlib import Path

from twin.kernel.recording.sources.stamps import Counts
from twin.kernel.serialise import to_dict
from twin.studies.result import Block, Column, Result, Table, count_text, note
from twin.studies.shadow.ahead import PredictionScore
from twin.studies.shadow.alarm import CHANNELS, WatchEvent
from twin.studies.shadow.statistics import RunningStatistics
from twin.studies.shadow.verdict import PLANT_JOINT, SIGNAL_COLUMNS, SessionSummary, verdict_of

LINE_WIDTH = 79
"""Width of the status line; some terminals wrap at column 80."""
LATENESS_BOUNDS = (1e-4, 2e-4, 5e-4, 1e-3, 2e-3, 5e-3, 0.01, 0.02, 0.05, 0.1, 0.2, 0.5, 1.0, 10.0)
"""Bounds of the lateness histogram (s)."""
RESIDUAL_COLUMNS = (
    Column("twin less robot", 26, left=True),
    Column("mean", 9, "+.4f"),
    Column("rms", 9, ".4f"),
    Column("largest", 9, "+.4f"),
    Column("at", 10, ".3f", "s"),
    Column("", left=True, gap=2),
)
RESIDUAL_UNITS = {
    "force": ("pressing force, estimated", "N", "N", 1.0),
    PLANT_JOINT: ("joint {}, plant model", "rad", "deg", math.degrees(1.0)),
    "command": ("command of motor {}", "rad/s", "rad/s", 1.0),
}
"""Text, SI unit, shown unit and scale by kind of residual."""


def status_line(t: float, period: float, late: float, counts: Counts, NIS: float, level: float, joints: float) -> str:
    """Format the status line of a session, at most `LINE_WIDTH` wide; NaN values are left out.

    Args:
        t: time of the last sample (s).
        period: period of the samples (s); infinite if unknown.
        late: 99 % quantile of the messages' lateness (s).
        NIS: mean NIS per count of the last second.
        joints: largest mean joint residual of the last second (rad).
    """
    gaps = count_text(counts.gaps, "gap")
    missing, joint = f"{counts.missing} missing in {gaps}", f"joints {math.degrees(joints):.3f} deg"
    rate = f"{1.0 / period:.0f} Hz" if period < math.inf else "- Hz"
    line = ""
    # shorter texts for a full line
    for lost, last in ((missing, joint), (missing, ""), (gaps, "")):
        parts = [f"{t:.1f} s", rate, "" if math.isnan(late) else f"late {1e3 * late:.3g} ms", lost]
        parts += [f"{name} {value:.3g}" for name, value in (("NIS", NIS), ("alarm", level)) if math.isfinite(value)]
        line = "  ".join(filter(None, [*parts, last if math.isfinite(joints) else ""]))
        if len(line) <= LINE_WIDTH:
            break
    return line


def shadow_result(followed: SessionSummary, name: str, files: Mapping[str, Path]) -> Result:
    """Create the report of a finished session; name: experiment; files: kind -> path."""
    counts = followed.counts
    rate = f", {1.0 / followed.period:.4g} Hz" if math.isfinite(followed.period) else ""
    body: list[Block] = []
    NIS = followed.residuals.get("NIS")
    shown = {key: one for key, one in followed.residuals.items() if one.count and one is not NIS}
    if shown:
        body += ["", Table(RESIDUAL_COLUMNS, [_row(key, one) for key, one in shown.items()]), ""]
    if NIS and NIS.count:
        body.append(note("filter", f"NIS {NIS.mean:.3g} per count while it moves; beyond 1 is worse than expected"))
    body += [note("samples", f"{counts.samples}{rate}, {_missing(followed)}"), note("order", _order(followed))]
    if math.isfinite(followed.offset):
        body.append(note("clock", _clock(followed)))
    if followed.in_hand.count:
        hand = followed.in_hand
        shares = ", ".join(f"{100.0 * share:g} % within {_ms(hand.quantile(share))}" for share in (0.99, 0.999))
        body.append(note("in hand", f"estimate after {_ms(hand.quantile(0.5))}, {shares}, all within "
                                    f"{_ms(hand.largest)}; {followed.missed} later than a period"))  # fmt: skip
    if followed.ahead is not None and followed.ahead.predictions:
        body += [note("ahead", text, True) for text in _prediction_texts(followed.ahead, not followed.caution)]
    if followed.alarms is not None:
        body += [note("alarm", text, True) for text in followed.alarms or ["none"]]
    missing = [name for name in SIGNAL_COLUMNS if name not in followed.measured_signals]
    body.append(
        note("watched", ", ".join(followed.measured_signals) + (f"; no {', no '.join(missing)}" if missing else ""))
    )
    verdict = verdict_of(followed)
    body.append(note("verdict", verdict.text, True))
    body += [note("note", text) for text in followed.notes]
    head = f"{name}: followed {followed.source} for {followed.seconds:.2f} s"
    paths = {kind: str(path) for kind, path in files.items()}
    facts = shadow_facts(followed, name) | paths
    return Result(head, body, facts, paths, exit_code=1 if verdict.kind == "diverge" else 0)


def _row(key: str, one: RunningStatistics) -> list[str | float]:
    kind, number = _kind(key)
    what, _, unit, scale = RESIDUAL_UNITS[kind]
    return [what.format(number), scale * one.mean, scale * one.rms, scale * one.largest, one.largest_time, unit]


def _kind(key: str) -> tuple[str, str]:
    """Split the key of a residual into kind and number: `plant joint` and `1`."""
    name = key.rstrip("0123456789")
    return name.rstrip(), key.removeprefix(name)


def _missing(followed: SessionSummary) -> str:
    counts = followed.counts
    found = {
        f"missing in {count_text(counts.gaps, 'gap')}": counts.missing, "incomplete": counts.incomplete,
        "came with NaN": counts.invalid, "before the first left out": counts.unmatched,
    }  # fmt: skip
    return _counts_text(found) or "none missing"


def _order(followed: SessionSummary) -> str:
    counts = followed.counts
    found = {
        "twice": counts.duplicates, "out of order": counts.out_of_order, "too late": counts.late,
        "restarts of the clock": counts.restarts, "lost by the transport": followed.dropped,
    }  # fmt: skip
    return _counts_text(found) or "all messages once and in order"


def _counts_text(counts: Mapping[str, int]) -> str:
    return ", ".join(f"{number} {what}" for what, number in counts.items() if number)


def _clock(followed: SessionSummary) -> str:
    lateness, offset = followed.lateness, followed.offset
    text = f"messages up to {_ms(lateness.quantile(0.99))} late (99 %), {_ms(lateness.largest)} at most"
    if abs(offset) >= 5e-4:
        text += f"; the robot's clock is {abs(offset):.3f} s {'behind' if offset > 0 else 'ahead of'} ours"
    if abs(followed.drift) >= 2e-6:
        text += f" and goes {'slow' if followed.drift > 0 else 'fast'} by {1e6 * abs(followed.drift):.0f} us per s"
    return text


def _band(foreseen: PredictionScore, is_promised: bool) -> str:
    """Describe the band of the predictions; for a robot that was not identified a share below 95 % is not a failure."""
    if not foreseen.banded:
        return foreseen.no_band or "no band"
    text = f"{100.0 * foreseen.share:.0f} % of the estimated forces lay in the band"
    if foreseen.share < 0.95 and not is_promised:
        text += ", 95 % is promised of identified robots only"
    return f"{text}; partly {foreseen.no_band}" if foreseen.no_band else text


def _prediction_texts(foreseen: PredictionScore, is_promised: bool) -> list[str]:
    texts = [
        f"{count_text(foreseen.predictions, 'prediction')} of 1 s; {_band(foreseen, is_promised)}; off by "
        f"{foreseen.error.rms:.2f} N rms, the last value by {foreseen.hold_error.rms:.2f} N"
    ]
    for name, apart in foreseen.what_if_differences.items():
        worst = f", at most {apart.largest:+.2f} N at {apart.largest_time:.2f} s" if apart.largest else ""
        texts.append(f"what if {name}: {apart.rms:.2f} N rms from the prediction{worst}")
    return texts


def _ms(seconds: float) -> str:
    return f"{1e3 * seconds:.3g} ms"


def shadow_facts(followed: SessionSummary, name: str) -> dict[str, object]:
    """Convert all results of a session to numbers; keys carry units, missing values are None."""
    NIS = followed.residuals.get("NIS")
    residuals = {
        key: {
            "unit": RESIDUAL_UNITS[_kind(key)[0]][1],
            "count": one.count, "mean": one.mean, "rms": one.rms, "largest": one.largest, "at_s": one.largest_time,
        }
        for key, one in followed.residuals.items()
        if one.count and one is not NIS
    }  # fmt: skip
    lateness, verdict = followed.lateness, verdict_of(followed)
    return to_dict(
        {
            "experiment": name,
            "source": followed.source,
            "seconds": followed.seconds,
            "period_s": followed.period,
            "counts": asdict(followed.counts),
            "dropped": followed.dropped,
            "messages": lateness.count,
            "lateness_p99_s": lateness.quantile(0.99),
            "lateness_largest_s": lateness.largest,
            "lateness_at_most_s": [
                [bound, count]
                for bound, count in zip(LATENESS_BOUNDS, lateness.counts_below(LATENESS_BOUNDS), strict=True)
            ],
            "clock_offset_s": followed.offset,
            "clock_drift": followed.drift,
            "in_hand_p50_s": followed.in_hand.quantile(0.5),
            "in_hand_p99_s": followed.in_hand.quantile(0.99),
            "in_hand_p999_s": followed.in_hand.quantile(0.999),
            "in_hand_largest_s": followed.in_hand.largest,
            "in_hand_missed": followed.missed,
            "residuals": residuals,
            "nis_per_count": NIS.mean if NIS else math.nan,
            "alarms": followed.alarms,
            "verdict": verdict.kind,
            "verdict_text": verdict.text,
            "diverged_s": verdict.since,
            "measured": followed.measured_signals,
            "alarm_states": None if followed.changes is None else [_change(one) for one in followed.changes],
            "ahead": followed.ahead,
            "notes": followed.notes,
        }
    )


def _change(one: WatchEvent) -> dict[str, object]:
    evidence = {"channel": one.channel, "unit": CHANNELS[one.channel][2], "size": one.size, "since_s": one.since,
                "level": one.level} if one.channel else {}  # fmt: skip
    return {"t_s": one.t, "state": str(one.state), "alarm": one.alarm, "text": str(one), **evidence}
