"""Job of the explorer's warm processes: answers a page's requests by running experiments.

An answer is {"refused": message} for an InputRefused or ComponentFailed of any operation, or its result. Samples are
32-bit floats in base 64 under "block".
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
    MAX_POSES,
    Tile,
    panels_to_json,
    shown_panels,
    tiles,
)
from twin.report.explore.request import check_request
from twin.report.page.markup import DataBlock
from twin.report.page.panels import PanelRun, scene
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
"""Maximum width of a plot (pixels)."""
MAX_TICKS = 400_000
"""Maximum duration of an explored experiment (ticks): about half a second to simulate, and half a gigabyte of rows."""

Layout = Literal["", "fig4"]
"""Figure of the paper that replaces the panels: Fig. 4 in the paper's layout; "" without one."""
MAX_RUNS = 100
NO_RUN_FACTS = {"title": "", "trip": "", "numbers": [], "events": [], "values": {}, "command": ""}
"""Fields of an answer with a run that was not simulated here."""
_viewed_signals: dict[tuple[object, ...], frozenset[str]] = {}
"""Form of a view request -> signals that its last run needed; the next run with this form keeps only these."""


def answer_request(reporter: Reporter, here: str, base: dict[str, Any], ask: dict[str, Any]) -> dict[str, Any]:
    """Answer a page's request `ask` ("op" and its fields, unchecked) on a `PageBase`; a job for guarded processes.

    `here` is the working folder of the command; an FMU may have changed the current one.
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
    """Parse the explorer's command line into the base of all pages and the initial state of a page."""
    held, state = first_state(base, ask["settings"])
    return {"base": asdict(held), "state": state, **_describe(held, {"state": state})}


def _describe(base: PageBase, ask: Mapping[str, Any]) -> dict[str, Any]:
    """Return the sliders of a page's state and the available drives, bodies, panels and faults."""
    state = parse_state(base, ask["state"])
    experiment = state.base_experiment
    return {
        "title": experiment.title,
        "name": base.experiment,
        "duration": experiment.duration_ticks * experiment.cosim.tick,
        "sliders": [asdict(slider) for slider in known_sliders(base, state.drive, state.body).values()],
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
    """Simulate a page's state; return its numbers and the requested panels."""
    state, look = parse_state(base, ask["state"]), ViewRequest.from_request(ask)
    experiment = _check_duration(state.load())
    facts = {"title": experiment.title, "values": _derived_values(state, experiment), "command": state.command}
    try:
        return facts | _run_state(state, experiment, look, _viewed_signals.get(look.form, frozenset()))
    except UnknownSeries:
        # another drive or controller has different signals
        return facts | _run_state(state, experiment, look, frozenset())


def _check_duration(experiment: Experiment) -> Experiment:
    """Refuse an experiment that is too long to be simulated while a slider moves; else return it."""
    if experiment.duration_ticks > MAX_TICKS:
        raise InputRefused(
            f"duration_s: {experiment.duration_ticks:,} ticks are too many to be run while a slider moves; expected at "
            f"most {MAX_TICKS:,}"
        )
    return experiment


def _run_state(state: PageState, experiment: Experiment, look: "ViewRequest", only: frozenset[str]) -> dict[str, Any]:
    """Simulate an experiment, built from a page's state, and return the requested view of the run."""
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
        delay, none = (trip.tick - onset) * tick if trip else None, "it does not trip" if monitor else "no monitor here"
        if not monitor and watched:
            none = "a third-party monitor reports no time"
        numbers.append(Tile("monitor trips after the fault", "s", delay, "" if trip else none, 3))
    run = PanelRun(trace, experiment.values, fields)
    if look.layout and figure_of(experiment) != look.layout:
        raise InputRefused("layout: this experiment is not one of the paper's Fig. 4")
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
    """Return the experiment's values that follow from keys changed on the page, such as [plant] from [robot]."""
    before = state.base_experiment.values
    there = known_sliders(state.base, state.drive, state.body)
    found = {key: value_at(experiment.values, key) for key in there if key not in state.values}
    return {key: value for key, value in found.items() if value != value_at(before, key)}


class ViewRequest(NamedTuple):
    """View of a run that a page requests: span (begin and end, s), width of a plot (pixels), panels.

    `robot`: the player is open. `listed`: the answer lists all panels. `layout` is a figure of the paper that replaces
    them, "" without one.
    """

    titles: list[str]
    span: tuple[float, float]
    width: int
    robot: bool
    listed: bool
    layout: Layout

    @property
    def form(self) -> tuple[object, ...]:
        """Parts of the view request that determine which signals it needs."""
        return (tuple(self.titles), self.robot, self.listed, self.layout)

    @classmethod
    def from_request(cls, ask: Mapping[str, Any]) -> "ViewRequest":
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
        """Return the requested view of a run, or a log like one, panels and robot, JSON-serialisable.

        `end` is the end of the run (s). The panels of the runs `fig4` replace the requested ones; None for those.
        """
        block = DataBlock()
        span = self.span[0], min(self.span[1], end)
        found: dict[str, Any] = {
            "end": end,
            "all_panels": shown_panels(run) if self.listed else None,
            "scene": scene(run, block, MAX_POSES) if self.robot else None,
        }
        chosen = [] if self.layout else [panel for panel in EXPLORED_PANELS if panel.title in self.titles]
        shown, of = (FIG4_PANELS, fig4) if fig4 else (chosen, run)
        found["panels"] = panels_to_json(shown, of, block, span, self.width)
        return found | {"block": base64.b64encode(block.content()).decode("ascii")}


def _show_recording(base: PageBase, ask: Mapping[str, Any]) -> dict[str, Any]:
    """Return the requested view of a recorded run of results/, for comparison."""
    name = ask.get("run")
    if name not in [str(folder) for folder in _folders()]:
        raise InputRefused(f"run {str(name)[:80]!r}: no such run in results/")
    (run,) = report_runs([recording_in(Path(str(name)))])
    return NO_RUN_FACTS | {"title": run.title, **ViewRequest.from_request(ask).picture(run, run.end)}


def _log(base: PageBase, ask: Mapping[str, Any]) -> dict[str, Any]:
    """Return the requested view of a robot's log, for comparison."""
    run, note = log_run(ask, parse_state(base, {}).base_experiment)
    found = ViewRequest.from_request(ask).picture(run, run.end)
    if not ask.get("layout") and not any(row["curve"] for panel in found["panels"] for row in panel["rows"]):
        raise InputRefused(
            "the log has no signal of the plots that are shown; map its columns to encoder.count_m[0..2] and "
            "count_l[0..2], or scale.F_z, in NAME.map.toml next to it (twin log new LOG writes one), or show other "
            "plots"
        )
    return NO_RUN_FACTS | {"title": ask["log"], "note": note, **found}


def _folders() -> list[Path]:
    """Return the folders of finished runs in results/, the newest first."""
    runs = [run for home in (Path("results"), EXPLORED_FOLDER) for run in stored_runs(home) if run.is_finished]
    return [run.folder for run in sorted(runs, key=lambda run: -run.recording.stat().st_mtime)]


def _command(base: PageBase, ask: Mapping[str, Any]) -> dict[str, Any]:
    """Return the `twin run` command of a page's state, after checking that the experiment can be loaded."""
    state = parse_state(base, ask["state"])
    state.load()
    return {"command": state.command, "drive": state.drive, "body": state.body, "settings": state.settings}


def _onset(base: PageBase, ask: Mapping[str, Any]) -> dict[str, Any]:
    """Return the default onset (s) of a fault, in contact, as `twin faults` chooses it."""
    experiment = _check_duration(parse_state(base, ask["state"]).load())
    _, contact = default_onsets(healthy_run(replace(experiment, faults=())))
    return {"onset": contact * experiment.cosim.tick}


def _loops(base: PageBase, ask: Mapping[str, Any]) -> dict[str, Any]:
    # imported here: python-control takes a second to load
    from twin.report.explore.loops import loops

    point = ask.get("point")
    chosen = point if isinstance(point, int) and 0 <= point < 1000 else None
    return loops(parse_state(base, ask["state"]).load(), chosen)


REQUEST_HANDLERS: Mapping[str, Callable[[PageBase, Mapping[str, Any]], dict[str, Any]]] = {
    "begin": _begin,
    "describe": _describe,
    "show": _show,
    "recorded": _show_recording,
    "runs": lambda base, ask: {"runs": list(map(str, _folders()[:MAX_RUNS])), "logs": known_logs()},
    "save": lambda base, ask: {"saved": str(save_experiment(parse_state(base, ask["state"]), str(ask.get("name"))))},
    "command": _command,
    "onset": _onset,
    "adopt": lambda base, ask: {"state": adopt_state(base, ask["state"], ask["accepted"])},
    "log": _log,
    "loops": _loops,
    "score": lambda base, ask: claims(parse_state(base, ask["state"])),
}
