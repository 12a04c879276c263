"""The page on recordings of FMU systems: signals by unit, events, timing, components with hashes."""

import json
import tempfile
from collections.abc import Iterable, Sequence
from pathlib import Path
from typing import Any

import numpy as np

from twin.kernel.errors import InputRefused
from twin.kernel.recording.reader import Recording
from twin.report.page.markup import Markup, element, join_markup, table, thin_samples, thinning_factor
from twin.report.page.picture import figure
from twin.report.page.run import ReportRun
from twin.studies.figure import picture
from twin.studies.result import count_text

CURVE_SAMPLES = 4000
"""Maximum number of samples of a curve; more than the pixels of a picture's width."""
MAX_PANEL_CURVES, MAX_PANELS = 8, 24
"""Maximum number of curves of a panel, and of panels of a run; more are seen in a viewer."""
MAX_EVENTS = 500


def is_system(recording: Recording) -> bool:
    """Whether `twin cosim` made the recording."""
    return "system" in recording.metadata


def system_sections(runs: Sequence[ReportRun]) -> tuple[str, list[tuple[str, str, Markup]]]:
    """Return the headline and the sections (key, title, content) of the report on `twin cosim` runs."""
    for run in runs:
        if not is_system(run.recording):
            raise InputRefused(
                f"{run.recording.path}: records the robot, and another run a system of FMUs; write a page for each kind"
            )
    sentence = " ".join(_sentence(run, f"{run.label}: " if len(runs) > 1 else "") for run in runs)
    found = [("verdict", "What ran", element("p", sentence, class_="headline plain"))]
    for number, run in enumerate(runs):
        of = f" of {run.label}" if len(runs) > 1 else ""
        found += [
            (f"signals-{number}", f"Signals{of}", _signals(run)),
            (f"events-{number}", f"Events{of}", _events(run)),
            (f"components-{number}", f"Components{of}", _components(run)),
            (f"timing-{number}", f"Timing{of}, how it was run", join_markup([_timing(run), _origin(run)])),
        ]
    return sentence, found


def _sentence(run: ReportRun, before: str) -> str:
    parts = len(run.recording.metadata.get("components", {}))
    ended = "" if run.recording.complete else f" It did not get to its end: {run.recording.note}."
    worst = [event for event in run.recording.events if event.level in ("warning", "error")]
    warned = f"{len(worst)} warnings or errors" if worst else "no warnings"
    return f"{before}{parts} component{'s' * (parts != 1)}, {run.end:g} s, {warned}.{ended}"


def _signals(run: ReportRun) -> Markup:
    """Return pictures of a system's recorded signals, one per unit, with at most `MAX_PANEL_CURVES` curves a panel."""
    by_unit: dict[str, list[tuple[str, str, int | None]]] = {}
    for key, field in run.recording.fields().items():
        for column in range(field.size):
            name = key if field.size == 1 else f"{key}[{column}]"
            by_unit.setdefault(field.unit, []).append((name, key, None if field.size == 1 else column))
    parts, panels, left = [], 0, 0
    for unit, curves in by_unit.items():
        shown = curves[: max(0, MAX_PANELS - panels) * MAX_PANEL_CURVES]
        left += len(curves) - len(shown)
        if shown:
            panels += -(-len(shown) // MAX_PANEL_CURVES)
            parts.append(figure(_draw_signals(run, unit, shown), f"{count_text(len(shown), 'signal')} in {unit}"))
    hint = f"{left} more signals are not drawn; choose with twin cosim --record." if left else ""
    return join_markup([*parts, element("p", hint, class_="hint")] if hint else parts)


def _draw_signals(run: ReportRun, unit: str, curves: Sequence[tuple[str, str, int | None]]) -> bytes:
    panels = [curves[first : first + MAX_PANEL_CURVES] for first in range(0, len(curves), MAX_PANEL_CURVES)]
    with tempfile.TemporaryDirectory() as folder:
        path = Path(folder) / "signals.png"
        with picture(path, 10.0, 0.6 + 2.2 * len(panels)) as drawing:
            axes = drawing.subplots(len(panels), 1, sharex=True, squeeze=False)[:, 0]
            for axis, shown in zip(axes, panels, strict=True):
                for name, key, column in shown:
                    t, values = run.time(key.rpartition(".")[0]), run.column(key, column).astype(float)
                    factor = thinning_factor(len(t), CURVE_SAMPLES)
                    # thinned samples are pairs of extremes; spread each pair over the times it covers
                    stamps = t if factor == 1 else np.interp(np.arange(-(-len(t) // (2 * factor)) * 2) * factor,
                                                             np.arange(len(t)), t)  # fmt: skip
                    axis.plot(stamps, thin_samples(values, factor), lw=1.0, label=name)
                axis.set_ylabel(unit)
                axis.legend(loc="center left", bbox_to_anchor=(1.0, 0.5), fontsize="small")
            axes[-1].set_xlabel("t, s")
        return path.read_bytes()


def _events(run: ReportRun) -> Markup:
    shown = run.recording.events[:MAX_EVENTS]
    rows = [(f"{event.time:.6g} s", event.level, event.name, event.text) for event in shown]
    if not rows:
        return element("p", "None.")
    more = len(run.recording.events) - len(shown)
    hint = [element("p", f"and {more} more, see the recording", class_="hint")] if more else []
    return join_markup([table(("at", "level", "of", "what"), rows, f"events of {run.label}"), *hint])


def _components(run: ReportRun) -> Markup:
    costs = run.summary.get("components", {})
    rows = []
    for path, text in run.recording.metadata.get("components", {}).items():
        one = json.loads(text)
        cost = costs.get(path, {}).get("microseconds_per_step") if isinstance(costs, dict) else None
        set_ = ", ".join(f"{name} = {value}" for name, value in one.get("set", {}).items())
        facts = (one["file"], f"FMI {one['fmi']}", one.get("generation_tool") or "-", element("code", one["sha256"]))
        rows.append((path, *facts, set_ or "-", "-" if cost is None else f"{cost:.3g} us"))
    head = ("component", "file", "standard", "made with", "SHA-256", "set", "per step")
    return table(head, rows, f"components of {run.label}")


def _timing(run: ReportRun) -> Markup:
    shown = (("simulated", "simulated_s", "s"), ("stepping", "stepping_s", "s"), ("recording", "recording_s", "s"),
             ("times as fast as real time", "real_time_factor", ""))  # fmt: skip
    rows = [
        (text, f"{value:.4g} {unit}".rstrip())
        for text, key, unit in shown
        if isinstance(value := run.summary.get(key), float)
    ]
    if not rows:
        return element("p", "The duration was not saved with the recording.")
    return table(("", "time"), rows, f"time that {run.label} took")


def _origin(run: ReportRun) -> Markup:
    its: dict[str, Any] = run.recording.metadata["system"]
    rows: list[Iterable[str]] = [
        ("file", its["file"]),
        ("SHA-256", element("code", its["sha256"])),
        ("coupling", f"{its['scheme']}, steps of {1e3 * float(its['tick']):g} ms"),
        ("order", ", ".join(json.loads(its["order"]))),
        *(("connection", f"{source} -> {target}") for source, target in json.loads(its["wires"])),
        *((f"input {name}", about) for name, about in run.recording.metadata.get("inputs", {}).items()),
        *((f"version of {name}", text) for name, text in run.recording.metadata.get("versions", {}).items()),
        ("recording", element("code", run.sha256)),
    ]
    facts = table(("", "is"), [tuple(row) for row in rows], f"origin of {run.label}")
    return element("details", element("summary", "System and versions"), facts)
