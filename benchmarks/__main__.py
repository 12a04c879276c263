"""Run every benchmark, print one table, write results/bench.json. Exit code 0 even where a target is missed."""

import json
import os
import platform
from dataclasses import asdict
from pathlib import Path

from benchmarks import dask, figure_4, fmi_versions, isolation, live, macro_step, report, start_up, sweep, tasks
from benchmarks.measurement import Measurement

ROOT = Path(__file__).parents[1]
EXPERIMENT = ROOT / "experiments" / "fig4_force_position.toml"
RESULT = ROOT / "results" / "bench.json"


def line(measurement: Measurement) -> str:
    """One line of the table, 80 columns at most."""
    value = "-" if measurement.value is None else f"{measurement.value:.3g}"
    if measurement.value is not None and measurement.value >= 100:
        value = f"{measurement.value:.0f}"
    target = f"<= {measurement.at_most:g}" if measurement.at_most is not None else ""
    if measurement.at_least is not None:
        target = f">= {measurement.at_least:g}"
    return f"{measurement.name:<48}{value:>7} {measurement.unit:<3} {target:<7} {measurement.verdict}".rstrip()


def main() -> None:
    """Measure, print as results come, and write them down."""
    print(f"{platform.machine()}, {os.cpu_count()} cores, Python {platform.python_version()}")
    print(f"{'':<48}{'value':>7}     {'target':<7} verdict")
    everything: list[Measurement] = []
    for part in (
        lambda: macro_step.measurements(ROOT / "fmus" / "ideal_velocity"),
        lambda: macro_step.measurements(ROOT / "fmus" / "velocity_servo"),
        fmi_versions.measurements,
        lambda: figure_4.measurements(EXPERIMENT),
        lambda: tasks.measurements(ROOT / "experiments"),
        lambda: start_up.measurements(EXPERIMENT),
        lambda: isolation.measurements(EXPERIMENT),
        lambda: live.measurements(EXPERIMENT),
        lambda: report.measurements(EXPERIMENT),
        lambda: sweep.measurements(EXPERIMENT),
        lambda: dask.measurements(EXPERIMENT),
    ):
        found = part()
        everything += found
        print("\n".join(line(measurement) for measurement in found), flush=True)
    missed = [m.name for m in everything if m.verdict == "MISSED"]
    print(f"missed: {', '.join(missed)}" if missed else "no target missed")
    for remark in sorted({m.remark for m in everything if m.remark}):
        print(f"not measured: {remark}")
    RESULT.parent.mkdir(exist_ok=True)
    facts = {
        "machine": platform.machine(),
        "cores": os.cpu_count(),
        "python": platform.python_version(),
        "measurements": [asdict(m) | {"verdict": m.verdict} for m in everything],
    }
    RESULT.write_text(json.dumps(facts, indent=2) + "\n")


if __name__ == "__main__":
    main()
