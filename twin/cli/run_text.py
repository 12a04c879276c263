"""Output of `twin run` about a finished run: measures, outcome, events, parts, files; as text or as JSON."""

from collections.abc import Iterator, Mapping, Sequence
from typing import Any

from twin.kernel.archive import sha256
from twin.robot.paths import PROJECT_FOLDER
from twin.robot.run import measures
from twin.studies.result import count_text, wrap_text

MAX_EVENTS = 20
"""Maximum number of events listed; the recording has all of them."""


def run_text(run: Mapping[str, Any]) -> str:
    """Format the result of a run (fields of `twin.robot.run.Run`, `real_time_factor`, `remarks`, `experiment`).

    At most 80 columns except for paths.
    """
    speed = f"{run['simulated']:g} s at {run['real_time_factor']:.0f} x real time"
    values = measures.measured_values(run["outcome"]["measures"])
    lines = [f"{run['experiment']}  {speed}{_warning(values)}"]
    for remark in run["remarks"]:
        lines += wrap_text(remark, "  ")
    lines += [*_hold(values), *_outcome(run["outcome"], run["held"]), *_events(run)]
    if counts := run.get("robot_values"):
        # imported here: it takes a while to load
        from twin.robot.experiment.differences import robot_values_text

        lines.append(_row("robot", robot_values_text(counts)))
    lines += _drives(run)
    for role, text in run["parts"].items():
        lines += wrap_text(text.removeprefix(f"{role}: "), f"  {role:10} ")
    lines += [_row("substitute", f"{name}: {kind}") for name, kind in run["substituted"].items()]
    for number, text in enumerate(run.get("served", {}).get("lines", ())):
        lines += wrap_text(text, _row("" if number else "served", "")) if text else [""]
    return "\n".join([*lines, _row("recording", run["recording"])])


def run_facts(run: Mapping[str, Any]) -> dict[str, object]:
    """Convert the result of a run to JSON-serialisable values; `run` as in `run_text`."""
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
        "robot_values": run.get("robot_values"),
        "trip": run["trip"],
        "changed": run["changed"],
        "remarks": list(run["remarks"]),
        "punctuality": run["punctuality"],
        "measures": measures.with_units(measures.measured_values(run["outcome"]["measures"])),
        "held": [dict(one) for one in run["held"]],
        **({"served": run["served"]["facts"]} if "served" in run else {}),
        "events": [{"t_s": t, "level": level, "text": text} for t, level, text in run["events"]],
        **({"page": run["page"]} if "page" in run else {}),
    }


def _warning(values: measures.Values) -> str:
    """Return a warning of a run's large overshoot, `  OVERSHOOT 34.0 %, 1.70 N`; "" if it is not large."""
    share = values["hold_overshoot"].value
    if share is None or share <= measures.LARGE_OVERSHOOT:
        return ""
    texts = [measures.value_text(name, values) for name in ("hold_overshoot", "hold_overshoot_force")]
    return f"  OVERSHOOT {', '.join(texts)}"


def _hold(values: measures.Values) -> Iterator[str]:
    """Format the measures of a run's held force, or the reason why they are missing, then torque and work."""
    error, begin, end = (values[key] for key in ("hold_error", "hold_begin", "hold_end"))
    if error.value is None or begin.value is None or end.value is None:
        yield from wrap_text(f"none: {error.reason}", _row("held", ""))
    else:
        first, values = measures.first_measures(values), measures.drop_remark(values)
        if values["chatter_frequency"].value is not None:
            first[-1] += f" at {measures.value_text('chatter_frequency', values)}"
        holds = values["holds"].value or 1.0
        parts = f" in {holds:.0f} parts" * (holds > 1.0)
        yield from wrap_text(f"{begin.value:.1f} to {end.value:.1f} s{parts}: {', '.join(first)}", _row("held", ""))
    # skip zeros: a robot that stays on its axis has no lateral error
    rest = (measures.labelled_text(key, values) for key in measures.SECOND_KEYS if (values[key].value or 0.0) > 1e-6)
    yield from wrap_text(", ".join(rest), _row("", ""))


def _outcome(outcome: Mapping[str, Any], held: Sequence[Mapping[str, Any]]) -> Iterator[str]:
    if outcome["peak"] > 0.0:
        peak = f"at most {outcome['peak']:.2f} N, at {outcome['peak_time']:.2f} s"
        # after the tasks the robot does not press, so the force at the end means nothing
        yield _row("force", peak if held else f"{peak}, {outcome['end']:.2f} N in the last second")
        for one in held:
            yield from wrap_text(_held_text(one, len(held) > 1), _row("", ""))
        if "end_x" in outcome and not held:
            x, y = (measures.fixed_point(outcome[key], 2) for key in ("end_x", "end_y"))
            yield _row("", f"{x} N along x, {y} N along y in the last second")
        if outcome["force_error"] is not None:
            yield _row("", f"error since the first touch {outcome['force_error']:.2f} N rms, force loop on")
    else:
        yield _row("force", "none: it never touched")
    if outcome["lateral_error"] is None:
        return
    lateral, z = f"{1e3 * outcome['lateral_error']:.2f}", 1e3 * outcome["z_error"]
    beside = "" if lateral == "0.00" else f"{lateral} mm lateral and "
    yield _row("position", f"{beside}{z:.2f} mm in z from the reference, rms")


def _held_text(one: Mapping[str, Any], several: bool) -> str:
    """Format a held force of a run: `7.93 to 8.02 N for 8.00 N, 4.4 to 9.4 s, error 0.009 N`."""
    name = f"task {one['task']}: " if several else ""
    asked = f"{one['force']:.2f} N"
    if one["least"] is None:
        return f"{name}never held {asked}" if one["kind"] != "tap" else f"{name}never tapped"
    did = f"{count_text(one['taps'], 'tap')}, peaks " if one["kind"] == "tap" else ""
    error = "" if one["error"] is None else f", error {one['error']:.3f} N"
    force = f"{one['least']:.2f} to {one['largest']:.2f} N for {asked}"
    return f"{name}{did}{force}, {one['begin']:.1f} to {one['end']:.1f} s{error}"


def _events(run: Mapping[str, Any]) -> Iterator[str]:
    events = [(t, text) for t, level, text in run["events"] if level != "DEBUG"]
    for t, text in events[:MAX_EVENTS]:
        yield from wrap_text(f"{t:8.3f} s  {text}", later=12)
    if len(events) > MAX_EVENTS:
        yield f"{'':8}    and {len(events) - MAX_EVENTS} more events, in the recording"


def _drives(run: Mapping[str, Any]) -> Iterator[str]:
    for drive in dict.fromkeys(run["drives"]):
        head, *rest = drive.splitlines()
        about, _, digest = head.partition("  sha256 ")
        yield _row("drive", about if digest and _comes_with_twin(about.split()[0], digest) else head)
        for line in rest:
            yield from wrap_text(line.strip(), " " * 13, 15)


def _comes_with_twin(name: str, digest: str) -> bool:
    """Whether the FMU `name` is one of twin's own, unmodified; `digest` is the beginning of its SHA-256."""
    files = [file for file in (PROJECT_FOLDER / "fmus").glob("*/*.fmu") if file.name == name]
    return any(sha256(file).startswith(digest) for file in files)


def _row(name: str, text: object) -> str:
    return f"  {name:10} {text}"
