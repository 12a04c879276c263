"""Run every benchmark, print one table, write results/bench.json. Exit code 1 if a target was missed.

With the name of a release a line is added to benchmarks/history.jsonl besides.
"""

import json
import os
import platform
import sys
from collections.abc import Callable, Mapping, Sequence
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
PARTS: tuple[Callable[[], list[Measurement]], ...] = (
    machine.measurements,
    lambda: macro_step.measurements(ROOT / "fmus" / "ideal_velocity"),
    lambda: macro_step.measurements(ROOT / "fmus" / "velocity_servo"),
    fmi_versions.measurements,
    exchange.measurements,
    masters.measurements,
    chain.measurements,
    lambda: figure_4.measurements(EXPERIMENT),
    lambda: other_parts.measurements(EXPERIMENT),
    lambda: build.measurements(EXPERIMENT),
    lambda: systems.measurements(EXPERIMENT),
    lambda: tasks.measurements(ROOT / "experiments"),
    lambda: adaptive.measurements(ROOT / "experiments"),
    lambda: start_up.measurements(EXPERIMENT),
    lambda: state.measurements(EXPERIMENT),
    lambda: past.measurements(ROOT / "experiments"),
    lambda: shadow.measurements(EXPERIMENT),
    lambda: shadow_live.measurements(EXPERIMENT),
    lambda: isolation.measurements(EXPERIMENT),
    lambda: live.measurements(EXPERIMENT),
    lambda: report.measurements(EXPERIMENT),
    lambda: explore.measurements(ROOT),
    lambda: sweep.measurements(EXPERIMENT),
    lambda: dask.measurements(EXPERIMENT),
)


def line(measurement: Measurement) -> str:
    """One line of the table, 80 columns at most."""
    value = "-" if measurement.value is None else f"{measurement.value:.3g}"
    if measurement.value is not None and measurement.value >= 100:
        value = f"{measurement.value:.0f}"
    target = f"<= {measurement.at_most:g}" if measurement.at_most is not None else ""
    if measurement.at_least is not None:
        target = f">= {measurement.at_least:g}"
    return f"{measurement.name:<48}{value:>7} {measurement.unit:<3} {target:<7} {measurement.verdict}".rstrip()


def closing(everything: Sequence[Measurement]) -> tuple[str, int]:
    """What is said below the table, and the exit code: 1 if a target was missed.

    A target that could not be measured is neither kept nor missed; it is named, with the reason.
    """
    missed = [m.name for m in everything if m.verdict == "MISSED"]
    lines = [f"missed: {', '.join(missed)}" if missed else "no target missed"]
    lines += [f"not measured: {m.name} ({m.remark or 'no reason given'})" for m in everything if m.value is None]
    return "\n".join(lines), 1 if missed else 0


def historic(release: str, facts: Mapping[str, Any]) -> str:
    """The line of a release: what was measured, without targets."""
    kept = {m["name"]: [float(f"{m['value']:.4g}"), m["unit"]] for m in facts["measurements"] if m["value"] is not None}
    return json.dumps({"release": release, **{k: facts[k] for k in ("machine", "cores", "python")}, "values": kept})


def main(release: str | None = None) -> int:
    """Measure, print as results come, and write them down, for `release` also into the history; the exit code."""
    print(f"{platform.machine()}, {os.cpu_count()} cores, Python {platform.python_version()}")
    print(f"{'':<48}{'value':>7}     {'target':<7} verdict")
    everything: list[Measurement] = []
    for part in PARTS:
        found = part()
        everything += found
        print("\n".join(line(measurement) for measurement in found), flush=True)
    summary, code = closing(everything)
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
    sys.exit(main(*sys.argv[1:2]))
