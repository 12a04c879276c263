"""The run of a system of FMUs: recording, text and facts."""

import json
import math
import os
from collections.abc import Iterator, Mapping, Sequence
from datetime import datetime
from pathlib import Path
from typing import Any

from twin.kernel.atomic_write import make_folder, write_bytes, write_json
from twin.kernel.cosim.observers import MessageObserver, ProgressObserver, SimulationResult, TickEvent
from twin.kernel.errors import ComponentFailed, EndRequest, InputRefused
from twin.kernel.fmi.variable import Variable, to_json
from twin.kernel.process.reporter import Reporter
from twin.kernel.process.states import (
    RunStates,
    StoredState,
    continuation_metadata,
    identity,
    refuse_other_run,
    simulate_saving,
    split_time,
    state_ticks,
    stored_state,
)
from twin.kernel.recording.folder import RECORDING_FILE, claim_run_folder, create_run_folder, recording_in
from twin.kernel.recording.recorder import BLOCK_TICKS, Recorder, versions
from twin.kernel.recording.writer import Writer
from twin.kernel.ssp.package import Package
from twin.kernel.systems.additions import Additions
from twin.kernel.systems.choice import MasterChoice
from twin.kernel.systems.coupling import PreparedSystem
from twin.kernel.systems.opening import open_plan, open_system
from twin.kernel.systems.plan import SystemPart, SystemPlan
from twin.kernel.systems.reading import read_system
from twin.kernel.systems.topics import streams
from twin.studies.result import Note, Result, count_text, join_names, note

MAX_ROWS = 6
"""Maximum number of rows of a list in the text; JSON has all."""
MAX_EVENTS = 20
UNSETTLED_NOTE = "the initial values never agree: inputs at the start follow from each other in a circle"
SCHEME_NAMES = {"gauss_seidel": "Gauss-Seidel in the order of the file", "jacobi": "Jacobi"}
SUMMARY_FILE = "summary.json"
"""File of the durations; they are kept out of the recording, which must not depend on them."""
COSIM_FOLDER = Path("results/cosim")
"""Folder of the runs, apart from the robot's, since a system often has its experiment's name."""


def run_summary(
    plan: SystemPlan,
    made: PreparedSystem,
    done: SimulationResult,
    events: Sequence[TickEvent],
    writing: float,
    recording: Path,
    state_every: float | None = None,
) -> dict[str, Any]:
    costs = done.costs
    # The last row, also if a component requested the end.
    end = done.simulation.next_tick - 1
    together = {name for loop in made.loops for name in loop.parts} if made.solved else set()
    simulated = (end - plan.timing.first) * plan.timing.tick
    return {
        "system": str(plan.package.file),
        "form": plan.package.form,
        "ssp": plan.package.structure.version,
        "scheme": plan.scheme,
        "tick_s": plan.timing.tick,
        "tick_from": plan.timing.source,
        "start_s": plan.timing.first * plan.timing.tick,
        "stop_s": plan.timing.ticks * plan.timing.tick,
        "stop_from": plan.timing.stop_source,
        "simulated_s": simulated,
        "stepping_s": done.stepping,
        "recording_s": writing,
        "real_time_factor": simulated / done.stepping,
        "components": {
            part.path: {
                "topic": part.name,
                "fmu": part.description.path.name,
                "fmi": part.description.model.fmiVersion,
                "kind": part.description.kind,
                "step_s": plan.timing.periods[part.path] * plan.timing.tick,
                "sha256": part.description.sha256,
                "microseconds_per_step": None if part.name in together else 1e6 * costs.get(part.name, 0.0),
            }
            for part in plan.parts
        },
        "connections": len(plan.wires) - len(plan.extras.feeds),
        "inputs": plan.extras.about,
        "unsaid": list(plan.package.omissions),
        "late": [f"{source}->{target}" for source, target in plan.delayed_connections],
        "not_fed": (unfed := {f"{part.path}.{v.name}": _start(part, v) for part in plan.parts for v in part.unfed}),
        # Name of the key in 1.0.
        "kept": unfed,
        "ignored": list(plan.ignored),
        "overruled": list(plan.overruled),
        "unreadable": list(plan.unreadable),
        "without_effect": list(_without_effect(plan, made, state_every)),
        "settled": made.settled,
        "ended": str(done.failure or ""),
        "forgiven": [*plan.forgiven, *made.forgiven],
        "loops": [
            {"path": loop.path, "solved": made.solved, "unstated": list(loop.silent)}
            | ({"microseconds_per_step": 1e6 * costs.get("+".join(loop.parts), 0.0)} if made.solved else {})
            for loop in made.loops
        ],
        "events": [
            {"t_s": e.tick * plan.timing.tick, "level": e.level, "text": e.text, "source": e.source} for e in events
        ],
        "recording": str(recording),
    }


def _without_effect(plan: SystemPlan, made: PreparedSystem, state_every: float | None) -> Iterator[str]:
    """Yield sentences on options that have no effect in a run of a system of FMUs."""
    choice, timing = plan.choice, plan.timing
    if choice.loops == "solve" and not made.loops:
        yield "--loops solve: no algebraic loop was found"
    if choice.lenient and not (plan.forgiven or made.forgiven):
        yield "--lenient: there was nothing to let through"
    if len(plan.parts) == 1:
        asked = {"--scheme": choice.scheme, "--order": choice.order}
        yield from (f"{option}: there is one FMU, {plan.parts[0].path}" for option, value in asked.items() if value)
    if state_every is not None and state_every >= timing.duration:
        yield f"--state-every-s {state_every:g}: the run is over after {timing.duration:g} s"


def _start(part: SystemPart, variable: Variable) -> Any:
    """Return the value of an FMU's input that has no source."""
    given = next((to_json(value) for v, value in part.settings if v == variable), variable.start)
    # For an array, FMPy has the start values as text.
    listed = [v.start for v in part.description.model.modelVariables if v.name == variable.name]
    return listed[0] if isinstance(given, float) and math.isnan(given) else given


def system_result(came: Mapping[str, Any]) -> Result:
    when = "the end of the last step" if came["scheme"] == "jacobi" else "the last step, leading back in the order"
    unfed = [f"{name} = {value:g}" if isinstance(value, float) else f"{name} = {value}"
            for name, value in came["not_fed"].items()]  # fmt: skip
    ignored = f"values that get to no variable: {join_names(came['ignored'], MAX_ROWS)}"
    overruled, more = f"{join_names(came['overruled'], MAX_ROWS)}, by connections", len(came["events"]) - MAX_EVENTS
    late = f"{count_text(len(came['late']), 'connection')} with values of {when}: {join_names(came['late'], MAX_ROWS)}"
    start = f" from {came['start_s']:g} s on" if came["start_s"] else ""
    parts = [
        note("system", f"{_form(came['form'], came['ssp'])}{count_text(came['connections'], 'connection')}", True),
        note(
            "coupling", f"{SCHEME_NAMES[came['scheme']]}, steps of {1e3 * came['tick_s']:g} ms by {came['tick_from']}"
        ),
        *([note("end", f"{came['stop_s']:g} s by {came['stop_from']}")] if came["stop_from"] else []),
        *(note(path, _component(one, came["tick_s"]), True) for path, one in came["components"].items()),
        *(note("input", f"{name} = {about}") for name, about in came["inputs"].items()),
        *([note("late", late, True)] if came["late"] else []),
        *(note("loop", _loop(one), True) for one in came["loops"]),
        *([note("not fed", join_names(unfed, MAX_ROWS), True)] if unfed else []),
        *([note("ignored", ignored, True)] if came["ignored"] else []),
        *([note("overruled", overruled, True)] if came["overruled"] else []),
        *([note("unreadable", join_names(came["unreadable"], MAX_ROWS), True)] if came["unreadable"] else []),
        *(note("no effect", sentence, True) for sentence in came["without_effect"]),
        *(note("unsaid", sentence) for sentence in came["unsaid"]),
        *([] if came["settled"] else [note("start", UNSETTLED_NOTE)]),
        *(note("forgiven", one, True) for one in came["forgiven"]),
        *([note("end", f"regular, before its time: {came['ended']}", True)] if came["ended"] else []),
        *(note("event", f"{e['t_s']:.3f} s  {e['source']}: {e['text']}") for e in came["events"][:MAX_EVENTS]),
        *([note("event", f"and {more} more, see the recording")] if more > 0 else []),
    ]
    speed = f"{came['real_time_factor']:.3g} x real time"
    headline = f"{Path(came['system']).stem}  {came['simulated_s']:g} s{start} at {speed}"
    return Result(headline, parts, came, {"recording": came["recording"]})


def _loop(one: Mapping[str, Any]) -> str:
    done = "not solved, one value late by a step; --loops solve"
    if one["solved"]:
        done = f"solved, {one['microseconds_per_step']:.2f} us"
    unstated = join_names(one["unstated"], MAX_ROWS)
    why = f" (perhaps: {unstated} does not state what its outputs depend on)" if unstated else ""
    return f"{one['path']}, {done}{why}"


def _form(form: str, version: str) -> str:
    return f"{form} {version}, " if form == "SSP" else f"{form}, "


def _component(one: Mapping[str, Any], tick: float) -> str:
    every = f", every {1e3 * one['step_s']:g} ms" if one["step_s"] != tick else ""
    kind = " model exchange" if one["kind"] == "model_exchange" else ""
    own = one["microseconds_per_step"]
    return f"{one['fmu']}  FMI {one['fmi']}{kind}  sha256 {one['sha256'][:12]}  {_duration(own)}{every}"


def _duration(own: float | None) -> str:
    return "in a loop" if own is None else f"{own:.2f} us" if own < 1e3 else f"{1e-3 * own:.1f} ms"


def record_system(
    reporter: Reporter,
    system: Path,
    choice: MasterChoice = MasterChoice(),  # noqa: B008, it is frozen
    out: Path | None = None,
    compiled: bool = False,
    state_every: float | None = None,
    start_from: str | None = None,
    additions: Additions = Additions(),  # noqa: B008, it is frozen
) -> Result:
    """Run a system of third-party FMUs and record it.

    Notes: {"experiment": name, "folder": folder of the run, "duration" (s)} before the first step.

    Args:
        out: folder of the run; None for results/cosim/NAME/TIME.
        compiled: whether to build FMUs without a binary for this machine from their sources.
        state_every: time between saved states (s); None to save only the last state.
        start_from: run of this system to continue, optionally with @ and the time (s) of a saved state.
    """
    reporter.loading()
    # Determined before an FMU is loaded, which may change the working directory.
    here = Path.cwd()
    package, state = read_system(system), _state(start_from)
    with open_system(package, choice, compiled, additions) as (plan, made):
        if out:
            claim_run_folder(here / out)
        folder = out or create_run_folder(here / COSIM_FOLDER, package.file.stem, datetime.now()).relative_to(here)
        path = here / folder / RECORDING_FILE
        reporter.note(experiment=package.file.stem, folder=str(path.parent), duration=plan.timing.duration)
        done, events, writing = _record_run(plan, made, path, reporter, state_every, state)
        came = run_summary(plan, made, done, events, writing, folder / RECORDING_FILE, state_every)
    write_json(here / folder / SUMMARY_FILE, came)
    return system_result(came)


def write_system(
    system: Path,
    choice: MasterChoice = MasterChoice(),  # noqa: B008, it is frozen
    out: Path | None = None,
    compiled: bool = False,
    additions: Additions = Additions(),  # noqa: B008, likewise
) -> Result:
    """Write a system as `out` (default NAME.ssp here) without running it; else as `record_system`."""
    for option, asked in (
        ("--record", additions.recorded),
        ("--solver", choice.solver),
        ("--loops solve", choice.loops == "solve"),
    ):
        if asked:
            raise InputRefused(f"{option}: an SSP archive has no word for it; choose when it is run")
    package = read_system(system)
    plan, file = write_ssp(package, choice, out, compiled, additions)
    rows = [note("system", f"{_form(package.form, package.structure.version)}{count_text(len(plan.parts), 'FMU')}")]
    rows += [note("unsaid", sentence) for sentence in package.omissions]
    found = {"system": str(package.file), "unsaid": list(package.omissions), "ssp": str(file)}
    return Result(f"{package.file.stem} written as SSP 1.0", rows, found, {"ssp": str(file)})


def write_ssp(
    package: Package, choice: MasterChoice, out: Path | None, compiled: bool, additions: Additions
) -> tuple[SystemPlan, Path]:
    from twin.kernel.systems.to_ssp import ssp_archive

    file = out or Path(f"{package.structure.system.name}.ssp")
    if os.path.exists(file):
        raise InputRefused(f"{file}: is there already; run it, or name another file with --out")
    with open_plan(package, choice, compiled, additions) as plan:
        content = ssp_archive(plan)
    make_folder(file.parent)
    write_bytes(file, content)
    return plan, file


def write_joined_system(
    fmus: Sequence[Path], choice: MasterChoice, out: Path | None, compiled: bool
) -> tuple[Path, list[Note]]:
    """Join FMUs by guessed wires and write the system as SSP; return the archive and notes on its wires."""
    # Guessing wires needs code for drives, which other systems do not load.
    from twin.studies.systems.joined import join_fmus

    package, doubtful = join_fmus(fmus, choice.lenient)
    _, file = write_ssp(package, choice, out, compiled, Additions())
    wires = [f"{'.'.join(one.start)} -> {'.'.join(one.end)}" for one in package.structure.system.connections]
    left = [f"{one.source} -> {one.target}" for one in doubtful]
    return file, [
        note("wires", f"guessed from names and units: {', '.join(wires)}", True),
        *([note("in doubt", f"left out: {join_names(left, MAX_ROWS)}", True)] if left else []),
    ]


def _state(start_from: str | None) -> StoredState | None:
    if start_from is None:
        return None
    path, time = split_time(start_from)
    recording = recording_in(Path(path))
    found = stored_state(recording, time)
    if found is None:
        when = "" if time is None else f" at {time:g} s or before"
        raise InputRefused(f"--from {start_from}: {recording} has no state{when}; run the system again without --from")
    return found


def _record_run(
    plan: SystemPlan,
    made: PreparedSystem,
    path: Path,
    reporter: Reporter,
    state_every: float | None,
    state: StoredState | None,
) -> tuple[SimulationResult, list[TickEvent], float]:
    rows, last, tick, described = streams(plan, made), plan.timing.ticks, plan.timing.tick, _provenance(plan, made)
    files = {part.path: part.description.sha256 for part in plan.parts}
    # Name and packing date of the archive do not affect the results.
    made_of = {key: text for key, text in described["system"].items() if key not in ("file", "sha256")}
    # Without inputs the identity is as in older recordings.
    fed = [described["inputs"]] if "inputs" in described else []
    about = identity(made.system, described["versions"], files, [made_of, described["components"], last, *fed])
    saved = state.saved_state if state else None
    if state and saved:
        refuse_other_run(saved, about, str(state.recording))
        described |= continuation_metadata(state)
    with Writer(path, [stream.topic for stream in rows], tick, described) as writer:
        recorder = Recorder(writer, rows)
        lasting = {"recorder": recorder}
        states = RunStates(state_ticks((), state_every, tick, last), last, tick, about, lasting)
        observers = [MessageObserver(made.system), recorder, ProgressObserver(reporter.progress, last + 1)]
        try:
            done = simulate_saving(made, last, observers, BLOCK_TICKS, states, saved, lasting)
        except ComponentFailed as failure:
            # Saving a component's state between two steps can fail too.
            raise ComponentFailed(recorder.abandon(failure)) from None
        if isinstance(done.failure, EndRequest):
            recorder.end(done.failure)
        elif done.failure:
            raise ComponentFailed(recorder.abandon(done.failure))
        recorder.finish()
    return done, recorder.events, recorder.writing


def _provenance(plan: SystemPlan, made: PreparedSystem) -> dict[str, dict[str, str]]:
    """Return the metadata on the origin of a system's recording, independent of time, place and user."""
    choice, timing = plan.choice, plan.timing
    periods = {path: period for path, period in timing.periods.items() if period > 1}
    kinds = {part.path: part.description.kind for part in plan.parts if part.description.kind != "co_simulation"}
    # Default options are left out.
    asked = {
        **({"first": str(timing.first)} if timing.first else {}),
        **({"periods": json.dumps(periods)} if periods else {}),
        **({"kinds": json.dumps(kinds), "solver": choice.method} if kinds else {}),
        **({"loops": choice.loops, "solved": json.dumps([one.path for one in made.loops])} if made.solved else {}),
        **({"forgiven": json.dumps([*plan.forgiven, *made.forgiven])} if choice.lenient else {}),
    }
    return {
        "system": asked
        | {
            "file": plan.package.file.name,
            "sha256": plan.package.sha256,
            "name": plan.package.structure.system.name,
            "ssp": plan.package.structure.version,
            "scheme": plan.scheme,
            "tick": repr(plan.timing.tick),
            "order": json.dumps([part.path for part in plan.parts]),
            "wires": json.dumps(plan.wires),
        },
        "components": {
            part.path: json.dumps(
                {
                    "file": part.description.path.name,
                    "sha256": part.description.sha256,
                    "model": part.description.model.modelName,
                    "fmi": part.description.model.fmiVersion,
                    "generation_tool": part.description.model.generationTool,
                    "set": {variable.name: to_json(value) for variable, value in part.settings},
                }
            )
            for part in plan.parts
        },
        "versions": versions(),
    } | ({"inputs": plan.extras.about} if plan.extras.about else {})
