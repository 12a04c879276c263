"""The job of a process that runs experiments for pages: one answer after the other, warm.

An answer is {"refused": sentence}, for an InputRefused or ComponentFailed of any operation, or what was asked for.
Samples are 32 bit floats in base 64 under "block".
"""

import base64
import math
import os
from collections.abc import Callable, Mapping
from dataclasses import asdict, replace
from pathlib import Path
from typing import Any, Literal, NamedTuple

from twin.kernel.cosim.observers import simulate
from twin.kernel.errors import ComponentFailed, InputRefused, UnknownSeries
from twin.kernel.process.reporter import Reporter
from twin.kernel.recording.folder import recording_in
from twin.kernel.recording.recorder import EventLog
from twin.report.explore import EXPLORED_FOLDER
from twin.report.explore.figures import claims, fig4_runs, figure_of
from twin.report.explore.logs import known_logs, log_run
from twin.report.explore.page_state import (
    PageBase,
    PageState,
    adopt_state,
    first_state,
    known_sliders,
    parse_state,
    save_experiment,
)
from twin.report.explore.picture import (
    EXPLORED_PANELS,
    INITIAL_PANELS,
    Tile,
    panels_to_json,
    poses,
    shown_panels,
    tiles,
)
from twin.report.explore.request import check_request
from twin.report.page.markup import DataBlock
from twin.report.page.panels import PanelRun
from twin.report.page.run import report_runs
from twin.robot.assembly.assemble import assemble
from twin.robot.experiment.experiment import Experiment
from twin.robot.experiment.fault import FAULT_KINDS
from twin.robot.experiment.source import value_at
from twin.robot.monitor.component import own_monitor, trip_reason
from twin.robot.run.trace import Trace, fields_of
from twin.robot.run.watch import run_observers
from twin.studies.faults.onsets import default_onsets, healthy_run
from twin.studies.metrics.required_series import FIG4_SERIES
from twin.studies.paper.fig4_figure import FIG4_PANELS
from twin.studies.paper.fig4_measures import Fig4Runs
from twin.studies.results.stored import stored_runs

MAX_WIDTH = 4000
"""Pixels of a plot."""
MAX_TICKS = 400_000
"""Of an experiment that is run while a slider moves: about half a second, and half a gigabyte of rows."""

Layout = Literal["", "fig4"]
"""What takes the place of the panels: Fig. 4 as the paper has it; "": nothing."""
MAX_RUNS = 100
"""Of results/ that are offered."""
NO_MONITOR = "no monitor here"
"""Reason where a number of the safety monitor would stand."""
_viewed_signals: dict[tuple[object, ...], frozenset[str]] = {}
"""What was read of a run for what a page wants to see: of the next one no more is kept."""


def answer_request(reporter: Reporter, here: str, base: dict[str, Any], ask: dict[str, Any]) -> dict[str, Any]:
    """What a page asks; a job of the guard.

    Args:
        here: the folder in which the command was started; an FMU may have changed it.
        ask: "op" and what belongs to it, as it came from the page: it may say anything.
    """
    reporter.loading()
    os.chdir(here)
    try:
        request = check_request(ask)
        return REQUEST_HANDLERS[request["op"]](PageBase(**base | {"settings": tuple(base["settings"])}), request)
    except InputRefused as refusal:
        return {"refused": str(refusal)}
    except ComponentFailed as failure:
        return {"refused": str(failure).splitlines()[0]}


def _begin(base: PageBase, ask: Mapping[str, Any]) -> dict[str, Any]:
    """What the command line says, taken apart: the base of all pages, and the state that a page begins with."""
    held, state = first_state(base, ask["settings"])
    return {"base": asdict(held), "state": state, **_describe(held, {"state": state})}


def _describe(base: PageBase, ask: Mapping[str, Any]) -> dict[str, Any]:
    """What can be changed, and what is there to choose from."""
    state = parse_state(base, ask["state"])
    experiment = state.base_experiment
    return {
        "title": experiment.title,
        "name": base.experiment,
        "duration": experiment.duration_ticks * experiment.cosim.tick,
        "sliders": [slider.to_dict for slider in known_sliders(base, state.drive, state.body).values()],
        "drives": list(base.drives),
        "bodies": list(base.bodies),
        "panels_at_first": INITIAL_PANELS,
        "figure": figure_of(experiment),
        "kinds": [
            {"kind": name} | {key: getattr(kind, key) for key in ("meaning", "targets", "unit", "magnitudes")}
            for name, kind in FAULT_KINDS.items()
        ],
    }


def _show(base: PageBase, ask: Mapping[str, Any]) -> dict[str, Any]:
    """A state that was run: its numbers, and the panels that the page shows."""
    state, look = parse_state(base, ask["state"]), ViewRequest.from_request(ask)
    experiment = _check_duration(state.load())
    facts = {"title": experiment.title, "values": _derived_values(state, experiment), "command": state.command}
    try:
        return facts | _run_state(state, experiment, look, _viewed_signals.get(look.form, frozenset()))
    except UnknownSeries:
        # another drive or controller has other signals
        return facts | _run_state(state, experiment, look, frozenset())


def _check_duration(experiment: Experiment) -> Experiment:
    """Return an experiment that is not too long to be run while a slider moves."""
    if experiment.duration_ticks > MAX_TICKS:
        raise InputRefused(
            f"duration_s: {experiment.duration_ticks:,} ticks are too many to be run while a slider moves; expected at "
            f"most {MAX_TICKS:,}"
        )
    return experiment


def _run_state(state: PageState, experiment: Experiment, look: "ViewRequest", only: frozenset[str]) -> dict[str, Any]:
    """What a run of `experiment`, which is `state`, comes to; only those signals of it are kept; none: all of them."""
    trace, events = Trace(only=only), EventLog()
    with assemble(experiment) as assembly:
        fields = fields_of(assembly.system)
        own = run_observers(experiment, assembly)
        observers = [own.tally, own.watch, events, trace]
        done = simulate(assembly, experiment.duration_ticks, observers).require_success()
        tick, monitor = assembly.system.tick, own_monitor(assembly.system)
        watched = assembly.system.has_output("monitor.tripped")
    numbers = tiles(own.tally.outcome, own.tally.held_forces)
    if experiment.faults:
        onset, trip = min(fault.onset for fault in experiment.faults), monitor.trip if monitor else None
        delay, none = (trip.tick - onset) * tick if trip else None, "it does not trip" if monitor else NO_MONITOR
        if not monitor and watched:
            none = "a third-party monitor reports no time"
        numbers.append(Tile("monitor trips after the fault", "s", delay, "" if trip else none, 3))
    run = PanelRun(trace, experiment.values, fields)
    if look.layout and figure_of(experiment) != look.layout:
        raise InputRefused("layout: this experiment is none of the paper's Fig. 4")
    found = look.picture(run, float(trace.t[-1]), fig4_runs(state, (experiment, trace)) if look.layout else None)
    _viewed_signals[look.form] = frozenset(run.used).union(FIG4_SERIES if look.layout else ())
    return found | {
        "trip": trip_reason(done.simulation),
        "numbers": numbers,
        "events": [
            {"run": 0, "t": event.tick * tick, "level": event.level.lower(), "text": event.text}
            for event in events.events
            if event.level != "DEBUG"
        ],
    }


def _derived_values(state: PageState, experiment: Experiment) -> dict[str, Any]:
    """Values of keys that follow from others that were changed, such as those of [plant] from [robot]."""
    before = state.base_experiment.values
    there = known_sliders(state.base, state.drive, state.body)
    found = {key: value_at(experiment.values, key) for key in there if key not in state.values}
    return {key: value for key, value in found.items() if value != value_at(before, key)}


class ViewRequest(NamedTuple):
    """View of a run that a page asks for.

    Attributes:
        titles: titles of panels.
        span: from when to when (s).
        width: width of a plot (pixels).
        robot: whether the player is open.
        listed: whether the answer lists the panels that the run has.
        layout: figure of the paper that takes the place of the panels; "" for none.
    """

    titles: list[str]
    span: tuple[float, float]
    width: int
    robot: bool
    listed: bool
    layout: Layout

    @property
    def form(self) -> tuple[object, ...]:
        """What decides on the signals that it needs."""
        return (tuple(self.titles), self.robot, self.listed, self.layout)

    @classmethod
    def from_request(cls, ask: Mapping[str, Any]) -> "ViewRequest":
        """Return the view that a checked request asks for."""
        titles, span, width = ask.get("panels") or [], ask.get("span"), ask.get("width") or 0
        if span is not None and (len(span) != 2 or not 0.0 <= span[0] < span[1]):
            raise InputRefused("span: expected two times in s, the earlier one first")
        if not 10 <= width <= MAX_WIDTH:
            raise InputRefused(f"width: expected pixels from 10 to {MAX_WIDTH}")
        layout: Layout = ask.get("layout") or ""
        if layout not in ("", "fig4"):
            raise InputRefused("layout: expected fig4")
        begin, end = map(float, span or (0.0, math.inf))
        return cls(titles, (begin, end), width, ask.get("robot") is True, ask.get("list") is True, layout)

    def picture(self, run: PanelRun, end: float, fig4: Fig4Runs | None = None) -> dict[str, Any]:
        """Return what the page wants to see of `run`, for JSON.

        Args:
            run: a run, or a log that reads like one.
            end: of the run (s).
            fig4: the four runs of Fig. 4, whose panels take the place of the others; None: none do.
        """
        block = DataBlock()
        span = self.span[0], min(self.span[1], end)
        found: dict[str, Any] = {
            "end": end,
            "all_panels": shown_panels(run) if self.listed else None,
            "scene": poses(run, block) if self.robot else None,
        }
        chosen = [] if self.layout else [panel for panel in EXPLORED_PANELS if panel.title in self.titles]
        shown, of = (FIG4_PANELS, fig4) if fig4 else (chosen, run)
        found["panels"] = panels_to_json(shown, of, block, span, self.width)
        return found | {"block": base64.b64encode(block.content()).decode("ascii")}


def _show_recording(base: PageBase, ask: Mapping[str, Any]) -> dict[str, Any]:
    """A run of results/, to be laid beside others."""
    name = ask.get("run")
    if name not in [str(folder) for folder in _folders()]:
        raise InputRefused(f"run {str(name)[:80]!r}: no such run in results/")
    (run,) = report_runs([recording_in(Path(str(name)))])
    return {"title": run.title, "trip": "", "numbers": [], "events": [], "values": {}, "command": "",
            **ViewRequest.from_request(ask).picture(run, run.end)}  # fmt: skip


def _log(base: PageBase, ask: Mapping[str, Any]) -> dict[str, Any]:
    """A log of a robot, to be laid beside others."""
    run, note = log_run(ask, parse_state(base, {}).base_experiment)
    found = ViewRequest.from_request(ask).picture(run, run.end)
    if not ask.get("layout") and not any(row["curve"] for panel in found["panels"] for row in panel["rows"]):
        raise InputRefused(
            "the log has no signal of the plots that are shown; map its columns to encoder.count_m[0..2] and "
            "count_l[0..2], or scale.F_z, in NAME.map.toml beside it (twin log new LOG writes one), or show other plots"
        )
    return {"title": ask["log"], "trip": "", "numbers": [], "events": [], "values": {}, "command": "", "note": note,
            **found}  # fmt: skip


def _folders() -> list[Path]:
    """Of finished runs, the newest first."""
    runs = [run for home in (Path("results"), EXPLORED_FOLDER) for run in stored_runs(home) if run.is_finished]
    return [run.folder for run in sorted(runs, key=lambda run: -run.recording.stat().st_mtime)]


def _runs(base: PageBase, ask: Mapping[str, Any]) -> dict[str, Any]:
    """What can be laid beside others: runs of results/, the newest first, and logs of robots."""
    return {"runs": [str(folder) for folder in _folders()[:MAX_RUNS]], "logs": known_logs()}


def _save(base: PageBase, ask: Mapping[str, Any]) -> dict[str, Any]:
    return {"saved": str(save_experiment(parse_state(base, ask["state"]), str(ask.get("name"))))}


def _command(base: PageBase, ask: Mapping[str, Any]) -> dict[str, Any]:
    """How the state is run by `twin run`: checked, so that only a run that can be made is begun."""
    state = parse_state(base, ask["state"])
    state.load()
    return {"command": state.command, "drive": state.drive, "body": state.body, "settings": state.settings}


def _onset(base: PageBase, ask: Mapping[str, Any]) -> dict[str, Any]:
    """Return where `twin faults` lets a fault begin in contact (s), in the state without faults."""
    experiment = _check_duration(parse_state(base, ask["state"]).load())
    _, contact = default_onsets(healthy_run(replace(experiment, faults=())))
    return {"onset": contact * experiment.cosim.tick}


def _loops(base: PageBase, ask: Mapping[str, Any]) -> dict[str, Any]:
    """The loops at one operating point."""
    # python-control takes a second to load
    from twin.report.explore.loops import loops

    point = ask.get("point")
    chosen = point if isinstance(point, int) and 0 <= point < 1000 else None
    return loops(parse_state(base, ask["state"]).load(), chosen)


def _score(base: PageBase, ask: Mapping[str, Any]) -> dict[str, Any]:
    """What the runs of the paper's figure, with this state, say to its claims."""
    return claims(parse_state(base, ask["state"]))


REQUEST_HANDLERS: Mapping[str, Callable[[PageBase, Mapping[str, Any]], dict[str, Any]]] = {
    "begin": _begin,
    "describe": _describe,
    "show": _show,
    "recorded": _show_recording,
    "runs": _runs,
    "save": _save,
    "command": _command,
    "onset": _onset,
    "adopt": lambda base, ask: {"state": adopt_state(base, ask["state"], ask["accepted"])},
    "log": _log,
    "loops": _loops,
    "score": _score,
}
"""By what a page asks for."""
