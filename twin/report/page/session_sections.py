"""The page on sessions with a robot: residuals, alarms, missing samples, punctuality."""

import math
from collections.abc import Iterator, Sequence
from functools import lru_cache
from pathlib import Path
from typing import Annotated

import numpy as np
from pydantic import BaseModel, ConfigDict, Field, ValidationError

from twin.kernel.errors import InputRefused
from twin.kernel.files import parse_json
from twin.kernel.recording.reader import Recording
from twin.report.page.markup import Markup, element, join_markup, table
from twin.report.page.panels import DEG, MAX_SAMPLES, MM, PanelRun, series
from twin.report.page.run import ReportRun, number_text
from twin.report.page.verdict import PageVerdict
from twin.studies.metrics.response import Curve
from twin.studies.panel import Panel, PanelCurve, Reader, Samples
from twin.studies.result import count_text
from twin.studies.shadow.alarm import nis_per_count
from twin.studies.shadow.branching import LEAD_SPACING, LEAD_TIMES, PREDICTION_HORIZON
from twin.studies.shadow.statistics import RunningStatistics

MAX_GAPS = 30
"""Maximum number of gaps that are listed, the longest ones."""
GAP_RATIO = 1.5
"""Minimum length of a gap, in periods between two samples, as in the session."""
UNFINISHED_TEXT = "The session was interrupted, so this was not recorded."
WholeNumber = Annotated[int, Field(ge=0, lt=2**63)]
RESIDUAL_TABLE = (
    ("residual/joints.theta_l", "joint {}, plant model less robot", "deg", DEG),
    ("residual/force.F_z", "pressing force, by counts less measured", "N", 1.0),
    ("residual/command.omega_ref", "command of motor {}, twin's controller less robot's", "rad/s", 1.0),
    ("shadow.residual_l", "joint {}, less what the filter expected", "deg", DEG),
    ("shadow.residual_m", "motor {}, less what the filter expected", "deg", DEG),
    ("shadow.residual_F", "measured force, less what the filter expected", "N", 1.0),
    ("shadow.residual_tau", "torque of motor {}, less what the filter expected", "mN m", 1e3),
)
"""Residuals: (signal, label, unit, factor from SI)."""
COUNT_LABELS = {
    "samples": "samples", "missing": "missing", "gaps": "gaps", "incomplete": "incomplete", "invalid": "with NaN",
    "duplicates": "messages twice", "out_of_order": "out of order", "late": "too late",
    "restarts": "restarts of the robot's clock",
}  # fmt: skip


def is_session(recording: Recording) -> bool:
    """Whether `twin shadow` made the recording."""
    return "shadow" in recording.metadata


def require_sessions(runs: Sequence[ReportRun]) -> None:
    """Refuse a report that mixes runs and sessions: a session has no true signals to compare a run with."""
    for run in runs:
        if not is_session(run.recording):
            raise InputRefused(
                f"{run.recording.path}: records a run, and another one a session with a robot; write a page for each "
                "kind, or compare signals with twin compare"
            )


class _RecordedModel(BaseModel):
    """Base of records that are parsed from a recording, whose content is untrusted."""

    model_config = ConfigDict(extra="ignore", allow_inf_nan=False)


class StateChange(_RecordedModel):
    """A recorded state change of a session's alarm; without a channel it has no evidence."""

    t_s: float
    state: str
    alarm: bool
    text: str
    channel: str = ""
    unit: str = ""
    size: float | None = None
    since_s: float | None = None
    level: float | None = None


class SessionFacts(_RecordedModel):
    """Recorded results of a `twin shadow` session, as far as the page shows them."""

    counts: dict[str, WholeNumber]
    dropped: WholeNumber
    messages: WholeNumber
    nis_per_count: float | None
    lateness_p99_s: float | None
    lateness_largest_s: float
    lateness_at_most_s: list[tuple[float, WholeNumber]]
    clock_offset_s: float | None
    clock_drift: float | None
    in_hand_p99_s: float | None
    in_hand_largest_s: float
    alarm_states: list[StateChange] | None
    verdict: str
    verdict_text: str
    notes: list[str]


def session_facts(run: ReportRun) -> SessionFacts | None:
    """Return the recorded results of a session; None if it did not end normally."""
    text = run.recording.metadata.get("followed", {}).get("facts")
    return None if text is None else _facts_of(text, run.recording.path)


@lru_cache(8)
def _facts_of(text: str, path: Path) -> SessionFacts:
    try:
        return SessionFacts.model_validate(parse_json(text, f"{path}: followed"))
    except ValidationError as mistake:
        first = mistake.errors(include_url=False)[0]
        place = ".".join(str(part) for part in first["loc"])
        raise InputRefused(f"{path}: its session results are damaged: {place}: {first['msg']}") from None


def even_samples(read: Reader) -> Reader:
    """Wrap a reader of samples so that it gives one sample per period, with NaN for missing ones as visible gaps."""

    def samples(run: PanelRun) -> Samples | None:
        found = read(run)
        if found is None or len(found[0]) < 3:
            return found
        t, values = found
        between = np.diff(t)
        if np.max(between) <= GAP_RATIO * np.median(between):
            return found
        step = max(float(np.median(between)), float(t[-1] - t[0]) / MAX_SAMPLES)
        grid = t[0] + step * np.arange(round((t[-1] - t[0]) / step) + 1)
        after = np.clip(np.searchsorted(t, grid), 1, len(t) - 1)
        nearest = after - (grid - t[after - 1] < t[after] - grid)
        there = np.abs(t[nearest] - grid) < 0.5 * GAP_RATIO * step
        return grid, np.where(there, values[nearest], np.nan).astype(np.float32)

    return samples


def _nis_samples(run: PanelRun) -> Samples | None:
    if not run.has("shadow.NIS", "shadow.used"):
        return None
    NIS, used = (np.asarray(run.column(f"shadow.{name}", None), dtype=float) for name in ("NIS", "used"))
    return run.time("shadow"), nis_per_count(NIS, used)


def predicted_samples(key: str, topic: str = "ahead") -> Reader:
    """Return a function that reads the later half of each prediction of `topic`, concatenated; NaN in between."""

    def samples(run: PanelRun) -> Samples | None:
        if not run.has(f"{topic}.{key}", f"{topic}.made"):
            return None
        made, late = run.column(f"{topic}.made", None), LEAD_TIMES > 0.5 * PREDICTION_HORIZON
        values = run.column(f"{topic}.{key}", None)[:, late]
        times = made[:, None] + LEAD_TIMES[late]
        place = np.rint((times - times[0, 0]) / LEAD_SPACING).astype(int)
        found = np.full(place[-1, -1] + 1, np.nan)
        found[place] = values
        return times[0, 0] + LEAD_SPACING * np.arange(len(found)), found

    return samples


def _limit(run: PanelRun) -> Samples | None:
    return (run.time("alarm"), np.ones(len(run.time("alarm")))) if run.has("alarm.level") else None


def _three_curves(label: str, key: str, scale: float) -> tuple[PanelCurve, ...]:
    return tuple(PanelCurve(f"{label} {i + 1}", "truth", even_samples(series(key, i, scale)), i) for i in range(3))


SESSION_PANELS = (
    Panel("Joint angles: plant model less robot", "deg", _three_curves("joint", "residual/joints.theta_l", DEG)),
    Panel(
        "Pressing force: by counts less measured", "N",
        (PanelCurve("residual", "truth", even_samples(series("residual/force.F_z"))),),
    ),
    Panel(
        "Commands: twin's controller less robot's", "rad/s",
        _three_curves("motor", "residual/command.omega_ref", 1.0),
    ),
    Panel("Joint angles: robot less what the filter expected", "deg", _three_curves("joint", "shadow.residual_l", DEG)),
    Panel("Motor angles: robot less what the filter expected", "deg", _three_curves("motor", "shadow.residual_m", DEG)),
    Panel(
        "Squared residuals by their variances, per count (NIS)", "1",
        (PanelCurve("NIS", "truth", even_samples(_nis_samples)),),
    ),
    Panel(
        "Alarm level", "1",
        (PanelCurve("largest sum by its threshold", "truth", even_samples(series("alarm.level"))),
         PanelCurve("alarm", "reference", even_samples(_limit))),
    ),
    Panel(
        "Pressing force F_z", "N",
        (PanelCurve("robot, by counts", "belief", even_samples(series("estimator.F_ee_B", 2, -1.0))),
         PanelCurve("plant model", "truth", even_samples(series("plant.F_ee_B", 2, -1.0))),
         PanelCurve("filter", "shifted", even_samples(series("shadow.F_ee_B", 2, -1.0)), shown=False),
         PanelCurve("measured", "display", even_samples(series("scale.F_z")))),
    ),
    Panel(
        "Pressing force F_z, predicted 0.5 to 1 s before", "N",
        (PanelCurve("filter", "belief", even_samples(series("shadow.F_ee_B", 2, -1.0))),
         PanelCurve("predicted", "shifted", predicted_samples("F_z")),
         PanelCurve("lower bound, 95 %", "display", predicted_samples("F_z_lower")),
         PanelCurve("upper bound, 95 %", "display", predicted_samples("F_z_upper")),
         PanelCurve("what if, 1st", "reference", predicted_samples("F_z", "what_if/1")),
         PanelCurve("what if, 2nd", "reference", predicted_samples("F_z", "what_if/2"), 1)),
    ),
    Panel(
        "Height z", "mm",
        (PanelCurve("robot, by counts", "belief", even_samples(series("estimator.p_B", 2, MM))),
         PanelCurve("plant model", "truth", even_samples(series("plant.p_B", 2, MM)))),
    ),
)  # fmt: skip


def session_verdict(runs: Sequence[ReportRun]) -> PageVerdict:
    """Judge recorded sessions with a robot; the headline begins with their alarms and other verdicts."""
    clauses, alarms, others, kinds = [], list[str](), list[str](), set[str]()
    for run in runs:
        facts, note = session_facts(run), run.recording.note
        own = [one for one in (facts.alarm_states or () if facts else ()) if one.alarm]
        if own:
            how = f"{count_text(len(own), 'alarm')}, the first at {own[0].t_s:.1f} s"
        elif facts:
            how = "no alarm" if facts.verdict == "match" else facts.verdict_text
        else:
            how = "not to its end"
        kinds.add(facts.verdict if facts else "")
        clauses.append(f"followed {_source(run)} for {run.end:.1f} s, {how}")
        alarms += [one.text for one in own]
        others += [*([note] if note else []), *(facts.notes if facts else ())]
    headline = "; ".join(clauses)
    unfinished = any(run.recording.note for run in runs)
    good = False if alarms or unfinished or "diverge" in kinds else True if kinds == {"match"} else None
    remarks = tuple(dict.fromkeys([*alarms, *others]))
    return PageVerdict(headline[0].upper() + headline[1:], good, remarks, (), None, None)


def _source(run: ReportRun) -> str:
    return run.recording.metadata["shadow"].get("source", "a robot")


def boxes(run: ReportRun) -> Markup:
    facts, found = session_facts(run), []
    if joints := [one.rms for _, _, one in _residuals(run, RESIDUAL_TABLE[:1])]:
        found.append((f"{max(joints):.3g} deg", "joints off, rms, the worst"))
    if facts:
        missing = facts.counts.get("missing", 0)
        found += [(number_text(facts.nis_per_count), "NIS per count")] if facts.nis_per_count is not None else []
        found.append((str(missing), f"missing, of {facts.counts.get('samples', 0) + missing}"))
        found.append((_ms(facts.lateness_p99_s), "late, 99 % of messages"))
        if facts.alarm_states is not None:
            found.append((str(sum(one.alarm for one in facts.alarm_states)), "alarms"))
    return element(
        "div",
        *(element("div", element("strong", value), element("span", text), class_="box") for value, text in found),
        class_="boxes",
    )


def residuals(run: ReportRun) -> Markup:
    rows = [
        (text, unit, f"{one.mean:+.3g}", f"{one.rms:.3g}", f"{one.largest:+.3g}", time_button(one.largest_time))
        for text, unit, one in _residuals(run)
    ]
    if not rows:
        return element("p", "No residuals.")
    return table(("residual", "unit", "mean", "rms", "largest", "at"), rows, f"residuals of {run.label}")


def _residuals(
    run: ReportRun, shown: Sequence[tuple[str, str, str, float]] = RESIDUAL_TABLE
) -> list[tuple[str, str, RunningStatistics]]:
    """Return the (label, unit, statistics in that unit) of each residual of a session."""
    found = []
    for key, text, unit, scale in shown:
        if not run.has(key):
            continue
        t = run.time(key.rpartition(".")[0])
        values = run.column(key, None).reshape(len(t), -1)
        for i in range(values.shape[1]):
            one = RunningStatistics()
            one.add(t, scale * values[:, i])
            if one.count:
                found.append((text.format(i + 1), unit, one))
    return found


def alarms(run: ReportRun) -> Markup:
    """Return the table of a session's alarm state changes with their evidence."""
    facts = session_facts(run)
    if facts is None:
        return element("p", UNFINISHED_TEXT)
    if facts.alarm_states is None:
        return element("p", "The alarm was off.")
    if not facts.alarm_states:
        return element("p", "None; the watch was listening all the time.")
    rows = []
    for one in facts.alarm_states:
        unit = "" if one.unit == "1" else one.unit
        off = "" if one.size is None else f"{one.size:+.3g} {unit}"
        level = "" if one.level is None else f"{one.level:.2f}"
        since = "" if one.since_s is None else time_button(one.since_s)
        state = element("span", "robot and twin diverge", class_="bad") if one.alarm else one.state
        rows.append(
            (time_button(one.t_s), state, one.channel, off, since, level, "" if off else one.text.partition(": ")[2])
        )
    head = ("at", "state", "of", "off by", "since", "level", "found")
    return table(head, rows, f"states of the alarm in {run.label}")


def gaps(run: ReportRun) -> Markup:
    """Return the section on a session's missing and discarded samples, and the longest gaps."""
    facts, parts = session_facts(run), [element("p", UNFINISHED_TEXT)]
    if facts:
        rows = [(text, str(facts.counts[key])) for key, text in COUNT_LABELS.items() if key in facts.counts]
        rows.append(("lost by the transport, as reported by it", str(facts.dropped)))
        parts = [table(("", "number"), rows, f"what came in {run.label}")]
    if longest := sorted(_gaps(run), key=lambda one: -one[1])[:MAX_GAPS]:
        found = [(time_button(at), f"{length:.4g} s", str(missing)) for at, length, missing in longest]
        parts += [
            element("h3", "The longest gaps"),
            table(("from", "length", "missing"), found, f"gaps of {run.label}"),
        ]
    return join_markup(parts)


def _gaps(run: ReportRun) -> Iterator[tuple[float, float, int]]:
    """Yield begin (s), length (s) and number of missing samples of each gap in a session."""
    t: Curve = run.time("encoder") if any(key.startswith("encoder.") for key in run.fields) else np.empty(0)
    if len(t) < 3:
        return
    between = np.diff(t)
    period = float(np.median(between))
    for k in np.flatnonzero(between > GAP_RATIO * period):
        yield float(t[k]), float(between[k]), max(1, round(between[k] / period) - 1)


def punctuality(run: ReportRun) -> Markup:
    """Return the histogram of a session's message lateness, and the robot's clock against this machine's."""
    facts = session_facts(run)
    if facts is None:
        return element("p", UNFINISHED_TEXT)
    bins, before, low = [], 0, 0.0
    for bound, total in [*facts.lateness_at_most_s, (math.inf, facts.messages)]:
        up_to = f"{1e3 * low:g} to {1e3 * bound:g} ms" if math.isfinite(bound) else f"more than {1e3 * low:g} ms"
        bins.append((up_to, total - before))
        before, low = total, bound
    # up to the last bin with messages
    while bins and not bins[-1][1]:
        del bins[-1]
    most = max((count for _, count in bins), default=1)
    rows = [
        (text, str(count), f"{count / max(facts.messages, 1):.2%}",
         element("div", element("div", style=f"width:{100 * count / most:.1f}%"), class_="share"))
        for text, count in bins
    ]  # fmt: skip
    clock = [
        ("late, 99 % of messages", _ms(facts.lateness_p99_s)),
        ("late, at most", _ms(facts.lateness_largest_s)),
    ]
    if facts.clock_offset_s is not None:
        clock.append(("the robot's clock is behind this machine's by", f"{facts.clock_offset_s:+.4f} s"))
    if facts.clock_drift is not None:
        clock.append(("and goes slow by", f"{1e6 * facts.clock_drift:+.1f} us per s"))
    if facts.in_hand_p99_s is not None:
        clock.append(("from receipt of a sample to its estimate, 99 %", _ms(facts.in_hand_p99_s)))
        clock.append(("from receipt of a sample to its estimate, at most", _ms(facts.in_hand_largest_s)))
    lateness = table(("later than the quickest", "messages", "share", ""), rows, f"lateness in {run.label}")
    return join_markup([lateness, element("h3", "Clock"), table(("", "is"), clock, f"clock in {run.label}")])


def _ms(seconds: float | None) -> str:
    return "not known" if seconds is None else f"{1e3 * seconds:.3g} ms"


def origin(run: ReportRun) -> Markup:
    versions = run.recording.metadata.get("versions", {})
    rows = [
        ("source", _source(run)),
        ("experiment of the twin", run.name),
        ("recording", run.recording.path.name),
        ("its sha256", element("code", run.sha256)),
        ("versions", ", ".join(f"{name} {text}" for name, text in versions.items())),
    ]
    return table(("", "is"), rows, f"origin of {run.label}")


def time_button(t: float) -> Markup:
    return element("button", f"{t:.3f} s", type="button", class_="at", data_t=f"{t:.9g}")
