"""What a run of a system has to say."""

import math
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

from twin.kernel.cosim.observers import Simulated, TickEvent
from twin.kernel.fmi.setting import told
from twin.kernel.fmi.variable import Variable
from twin.studies.lines import counted
from twin.studies.result import Result, note
from twin.studies.systems.coupled import Coupled
from twin.studies.systems.plan import Part, Plan

MOST = 6
"""Of a list that are told; programs get all."""
MOST_EVENTS = 20
UNSETTLED = "the initial values never agree: inputs at the start follow from each other in a circle"
SCHEMES = {"gauss_seidel": "Gauss-Seidel in the order of the file", "jacobi": "Jacobi"}


def facts(
    plan: Plan, made: Coupled, done: Simulated, events: Sequence[TickEvent], writing: float, recording: Path
) -> dict[str, Any]:
    """For programs."""
    simulated = plan.timing.ticks * plan.timing.tick
    return {
        "system": str(plan.package.file),
        "ssp": plan.package.structure.version,
        "scheme": plan.scheme,
        "tick_s": plan.timing.tick,
        "tick_from": plan.timing.source,
        "simulated_s": simulated,
        "stepping_s": done.stepping,
        "recording_s": writing,
        "real_time_factor": simulated / done.stepping,
        "components": {
            part.path: {
                "topic": part.name,
                "fmu": part.description.path.name,
                "fmi": part.description.model.fmiVersion,
                "sha256": part.description.sha256,
                "microseconds_per_step": 1e6 * done.costs.get(part.name, 0.0),
            }
            for part in plan.parts
        },
        "connections": len(plan.wires),
        "late": [f"{source}->{target}" for source, target in plan.late],
        "kept": {f"{part.path}.{v.name}": _start(part, v) for part in plan.parts for v in part.kept},
        "ignored": list(plan.ignored),
        "settled": made.settled,
        "events": [
            {"t_s": e.tick * plan.timing.tick, "level": e.level, "text": e.text, "source": e.source} for e in events
        ],
        "recording": str(recording),
    }


def _start(part: Part, variable: Variable) -> Any:
    """The value of an input that nobody feeds."""
    given = next((told(value) for v, value in part.settings if v == variable), variable.start)
    # of an array FMPy has the text
    listed = [v.start for v in part.description.model.modelVariables if v.name == variable.name]
    return listed[0] if isinstance(given, float) and math.isnan(given) else given


def system_result(came: Mapping[str, Any]) -> Result:
    """For people, at most 80 columns but for paths; for programs what `facts` gave."""
    when = "the end of the last step" if came["scheme"] == "jacobi" else "the last step, leading back in the order"
    kept = [f"{name} = {value:g}" if isinstance(value, float) else f"{name} = {value}"
            for name, value in came["kept"].items()]  # fmt: skip
    ignored, more = f"values that get to no variable: {_some(came['ignored'])}", len(came["events"]) - MOST_EVENTS
    late = f"{counted(len(came['late']), 'connection')} with values of {when}: {_some(came['late'])}"
    parts = [
        note("system", f"SSP {came['ssp']}, {counted(came['connections'], 'connection')}", True),
        note("coupling", f"{SCHEMES[came['scheme']]}, steps of {1e3 * came['tick_s']:g} ms by {came['tick_from']}"),
        *(note(path, _component(one), True) for path, one in came["components"].items()),
        *([note("late", late, True)] if came["late"] else []),
        *([note("not fed", _some(kept), True)] if kept else []),
        *([note("ignored", ignored, True)] if came["ignored"] else []),
        *([] if came["settled"] else [note("start", UNSETTLED)]),
        *(note("event", f"{e['t_s']:.3f} s  {e['source']}: {e['text']}") for e in came["events"][:MOST_EVENTS]),
        *([note("event", f"and {more} more, see the recording")] if more > 0 else []),
    ]
    headline = f"{Path(came['system']).stem}  {came['simulated_s']:g} s at {came['real_time_factor']:.3g} x real time"
    return Result(headline, parts, came, {"recording": came["recording"]})


def _component(one: Mapping[str, Any]) -> str:
    return f"{one['fmu']}  FMI {one['fmi']}  sha256 {one['sha256'][:12]}  {one['microseconds_per_step']:.2f} us"


def _some(names: Sequence[str]) -> str:
    return ", ".join(names[:MOST]) + (f" and {len(names) - MOST} more" if len(names) > MOST else "")
