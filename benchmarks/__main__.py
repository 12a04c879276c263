"""Run every benchmark, print one table, write results/bench.json. Exit code 1: a target was missed or a part failed."""

import argparse
import json
import os
import platform
import sys
import traceback
from collections.abc import Callable, Iterable, Mapping, Sequence
from dataclasses import asdict
from pathlib import Path
from typing import Any

from benchmarks import (
    adaptive,
    build,
    chain,
    dask,
    exchange,
    explore,
    figure_4,
    fmi_versions,
    isolation,
    live,
    machine,
    macro_step,
    masters,
    other_parts,
    past,
    report,
    shadow,
    shadow_live,
    start_up,
    state,
    sweep,
    systems,
    tasks,
)
from benchmarks.measurement import Measurement

ROOT = Path(__file__).parents[1]
EXPERIMENT = ROOT / "experiments" / "fig4_force_position.toml"
RESULT = ROOT / "results" / "bench.json"
HISTORY = ROOT / "benchmarks" / "history.jsonl"
PARTS: Mapping[str, Callable[[], Iterable[Measurement]]] = {
    "machine": machine.measurements,
    "ideal_velocity": lambda: macro_step.measurements(ROOT / "fmus" / "ideal_velocity"),
    "velocity_servo": lambda: macro_step.measurements(ROOT / "fmus" / "velocity_servo"),
    "fmi_versions": fmi_versions.measurements,
    "exchange": exchange.measurements,
    "masters": masters.measurements,
    "chain": chain.measurements,
    "figure_4": lambda: figure_4.measurements(EXPERIMENT),
    "other_parts": lambda: other_parts.measurements(EXPERIMENT),
    "build": lambda: build.measurements(EXPERIMENT),
    "systems": lambda: systems.measurements(EXPERIMENT),
    "tasks": lambda: tasks.measurements(ROOT / "experiments"),
    "adaptive": lambda: adaptive.measurements(ROOT / "experiments"),
    "start_up": lambda: start_up.measurements(EXPERIMENT),
    "state": lambda: state.measurements(EXPERIMENT),
    "past": lambda: past.measurements(ROOT / "experiments"),
    "shadow": lambda: shadow.measurements(EXPERIMENT),
    "shadow_live": lambda: shadow_live.measurements(EXPERIMENT),
    "isolation": lambda: isolation.measurements(EXPERIMENT),
    "live": lambda: live.measurements(EXPERIMENT),
    "report": lambda: report.measurements(EXPERIMENT),
    "explore": lambda: explore.measurements(ROOT),
    "sweep": lambda: sweep.measurements(EXPERIMENT),
    "dask": lambda: dask.measurements(EXPERIMENT),
}


def line(measurement: Measurement) -> str:
    """One line of the table, 80 columns at most."""
    value = "-" if measurement.value is None else f"{measurement.value:.3g}"
    if measurement.value is not None and measurement.value >= 100:
        value = f"{measurement.value:.0f}"
    target = f"<= {measurement.at_most:g}" if measurement.at_most is not None else ""
    if measurement.at_least is not None:
        target = f">= {measurement.at_least:g}"
    return f"{measurement.name:<48}{value:>7} {measurement.unit:<3} {target:<7} {measurement.verdict}".rstrip()


def closing(everything: Sequence[Measurement], failed: Sequence[str] = ()) -> tuple[str, int]:
    """What is said below the table, and the exit code: 1 if a target was missed or a part failed.

    A target that could not be measured is neither kept nor missed; it is named, with the reason.
    """
    missed = [m.name for m in everything if m.verdict == "MISSED"]
    lines = [f"missed: {', '.join(missed)}" if missed else "no target missed"]
    lines += [f"not measured: {m.name} ({m.remark or 'no reason given'})" for m in everything if m.value is None]
    lines += [f"failed: {name}" for name in failed]
    return "\n".join(lines), 1 if missed or failed else 0


def historic(release: str, facts: Mapping[str, Any]) -> str:
    """The line of a release: what was measured, without targets."""
    kept = {m["name"]: [float(f"{m['value']:.4g}"), m["unit"]] for m in facts["measurements"] if m["value"] is not None}
    return json.dumps({"release": release, **{k: facts[k] for k in ("machine", "cores", "python")}, "values": kept})


def main(release: str | None = None, only: Sequence[str] = ()) -> int:
    """Measure, print as results come, and write them down, for `release` also into the history; the exit code.

    What goes wrong in a part is printed; the other parts go on.
    """
    print(f"{platform.machine()}, {os.cpu_count()} cores, Python {platform.python_version()}")
    print(f"{'':<48}{'value':>7}     {'target':<7} verdict", flush=True)
    everything: list[Measurement] = []
    failed: list[str] = []
    for name in only or PARTS:
        try:
            for measurement in PARTS[name]():
                everything.append(measurement)
                print(line(measurement), flush=True)
        except Exception as failure:
            traceback.print_exc()
            failed.append(f"{name} ({type(failure).__name__}: {str(failure).partition(chr(10))[0]})")
    summary, code = closing(everything, failed)
    print(summary)
    RESULT.parent.mkdir(exist_ok=True)
    facts = {
        "machine": platform.machine(),
        "cores": os.cpu_count(),
        "python": platform.python_version(),
        "measurements": [asdict(m) | {"verdict": m.verdict} for m in everything],
    }
    RESULT.write_text(json.dumps(facts, indent=2) + "\n")
    if release:
        with HISTORY.open("a") as history:
            history.write(historic(release, facts) + "\n")
    return code


if __name__ == "__main__":
    asked = argparse.ArgumentParser(prog="benchmarks", description=__doc__)
    asked.add_argument("release", nargs="?", help="adds a line to benchmarks/history.jsonl")
    asked.add_argument("--only", nargs="+", choices=PARTS, metavar="PART", default=(), help=", ".join(PARTS))
    given = asked.parse_args()
    if given.release and given.only:
        asked.error("a release has all parts; leave out --only")
    sys.exit(main(given.release, given.only))
