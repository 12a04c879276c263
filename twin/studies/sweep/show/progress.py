"""A sweep before and while it runs, in a line or three."""

from typing import Any

from twin.studies.sweep.sweep import State, SweepEstimate


def state_text(state: State) -> str:
    """`12 of 64 runs  9.1/s  6 s left  1 failed  force_error_N 0.31 (run 7)`."""
    parts = [f"{state.done} of {state.total} runs"]
    if state.remaining is not None:
        parts += [f"{state.rate:.3g}/s", f"{time_text(state.remaining)} left"]
    if state.failed:
        parts.append(f"{state.failed} failed")
    if state.best:
        metric, number, run = state.best
        parts.append(f"{metric} {number:.3g} (run {run})")
    return "  ".join(parts)


def estimate_text(name: str, runs: int, processes: int, estimate: SweepEstimate, first: dict[str, Any]) -> str:
    """What `runs` runs will take, and what that was measured on."""
    seconds, size = estimate.total(runs, processes)
    many = "process" if processes == 1 else "processes"
    reason = f": {first['reason']}" if first["reason"] else ""
    return "\n".join([
        f"{name}  {runs:,} runs, about {time_text(seconds)} in {processes} {many}, {size_text(size)}",
        f"  measured on run 1, {first['status']}{reason}",
        f"  {estimate.run:.3f} s per run in a warm process, {estimate.start:.1f} s until its first one is over",
    ])  # fmt: skip


def time_text(seconds: float) -> str:
    """`45 s`, `12 min` or `3.5 h`."""
    if seconds < 100.0:
        return f"{seconds:.0f} s"
    return f"{seconds / 60:.0f} min" if seconds < 6000.0 else f"{seconds / 3600:.1f} h"


def size_text(size: float) -> str:
    """Of `size` bytes: `9 kB`, `1.2 MB`."""
    return f"{size / 1e6:,.1f} MB" if size >= 1e6 else f"{max(1.0, size / 1e3):.0f} kB"
