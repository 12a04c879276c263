"""A run as text: the outcome, the events, the provenance, the files."""

from collections.abc import Iterator, Mapping, Sequence
from typing import Any

from twin.studies.result import counted, wrapped

MOST_EVENTS = 20
"""The most events that are listed; the recording has all of them."""


def run_text(run: Mapping[str, Any]) -> str:
    """For people, at most 80 columns but for paths.

    Args:
        run: the fields of `twin.robot.run.Run`, `real_time_factor`, `remarks`, and the name of the `experiment`.
    """
    speed = f"{run['simulated']:g} s at {run['real_time_factor']:.0f} x real time"
    lines = [f"{run['experiment']}  {speed}", *(f"  {remark}" for remark in run["remarks"])]
    lines += [*_outcome(run["outcome"], run["held"]), *_events(run), *_drives(run)]
    for role, text in run["parts"].items():
        lines += wrapped(text.removeprefix(f"{role}: "), f"  {role:10} ")
    lines += [_row("substitute", f"{name}: {kind}") for name, kind in run["substituted"].items()]
    return "\n".join([*lines, _row("recording", run["recording"])])


def run_facts(run: Mapping[str, Any]) -> dict[str, object]:
    """For programs; `run` as for `run_text`."""
    return {
        "experiment": run["experiment"],
        "recording": str(run["recording"]),
        "simulated_s": run["simulated"],
        "stepping_s": run["stepping"],
        "recording_s": run["writing"],
        "real_time_factor": run["real_time_factor"],
        "drives": list(run["drives"]),
        "substituted": dict(run["substituted"]),
        "parts": dict(run["parts"]),
        "trip": run["trip"],
        "changed": run["changed"],
        "punctuality": run["punctuality"],
        "held": [dict(one) for one in run["held"]],
        "events": [{"t_s": t, "level": level, "text": text} for t, level, text in run["events"]],
    }


def _outcome(outcome: Mapping[str, Any], held: Sequence[Mapping[str, Any]]) -> Iterator[str]:
    if outcome["peak"] > 0.0:
        peak = f"{outcome['peak']:.2f} N at {outcome['peak_time']:.2f} s at most"
        # at the end of its tasks a robot presses nothing
        yield _row("force", peak if held else f"{peak}, {outcome['end']:.2f} N in the last second")
        for one in held:
            yield from wrapped(_held(one, len(held) > 1), _row("", ""))
        if "end_x" in outcome and not held:
            yield _row("", f"{_force(outcome['end_x'])} along x, {_force(outcome['end_y'])} along y in the last second")
        if outcome["force_error"] is not None:
            yield _row("", f"{outcome['force_error']:.2f} N rms off the reference after the first touch, force loop on")
    else:
        yield _row("force", "none: it never touched")
    if outcome["lateral_error"] is None:
        return
    lateral, z = 1e3 * outcome["lateral_error"], 1e3 * outcome["z_error"]
    yield _row("position", f"{lateral:.2f} mm lateral and {z:.2f} mm in z rms off the reference")


def _held(one: Mapping[str, Any], several: bool) -> str:
    """`held 8.00 N: 7.93 to 8.02 N from 4.4 to 9.4 s`."""
    name = f"task {one['task']}: " if several else ""
    asked = f"{one['force']:.2f} N"
    if one["least"] is None:
        return f"{name}never held {asked}" if one["kind"] != "tap" else f"{name}never tapped"
    did = f"{counted(one['taps'], 'tap')} of {asked}: peaks" if one["kind"] == "tap" else f"held {asked}:"
    return f"{name}{did} {one['least']:.2f} to {one['largest']:.2f} N from {one['begin']:.1f} to {one['end']:.1f} s"


def _force(value: float) -> str:
    # no minus before what rounds to nothing
    return f"{round(value, 2) + 0.0:.2f} N"


def _events(run: Mapping[str, Any]) -> Iterator[str]:
    events = [(t, text) for t, level, text in run["events"] if level != "DEBUG"]
    for t, text in events[:MOST_EVENTS]:
        yield from wrapped(f"{t:8.3f} s  {text}", later=12)
    if len(events) > MOST_EVENTS:
        yield f"{'':8}    and {len(events) - MOST_EVENTS} more events, in the recording"


def _drives(run: Mapping[str, Any]) -> Iterator[str]:
    for drive in dict.fromkeys(run["drives"]):
        head, *rest = drive.splitlines()
        yield _row("drive", head)
        for line in rest:
            yield from wrapped(line.strip(), " " * 13, 15)


def _row(name: str, text: object) -> str:
    return f"  {name:10} {text}"
