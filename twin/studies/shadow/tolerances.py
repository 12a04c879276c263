"""Tolerances of the alarm by sampling rate: shipped for known experiments, else computed once and cached.

A file has the digest of the experiment and of the fleet that its tolerances were computed from.
"""

import hashlib
import json
import math
from collections.abc import Mapping
from dataclasses import asdict, replace
from pathlib import Path

from twin.kernel.atomic_write import json_text, write_text
from twin.kernel.cache_folder import cache_folder
from twin.robot.paths import PROJECT_FOLDER
from twin.studies.command import Say, ignore_progress
from twin.studies.shadow.alarm import RateTolerances, ShadowWatch, Tolerances
from twin.studies.shadow.command_comparison import MIN_TOLERANCE
from twin.studies.shadow.fleet import (
    MAX_LOST_SHARE,
    MAX_STAMP_ERROR,
    TOLERANCE_MARGIN,
    ZERO_RANGE,
    Fleet,
    block_means,
    fleet_limits,
    watch_blocks,
)

SHIPPED_FOLDER = PROJECT_FOLDER / "tests" / "baselines" / "shadow"
FLEET_FILE = PROJECT_FOLDER / "experiments" / "sweeps" / "healthy_fleet.toml"
PERIOD_FACTORS = (1, 2, 5, 10)
"""Sampling periods with tolerances, in periods of the controller."""
CHECKED_RATE = 1.0
"""Rate of false alarms per hour for the check that the alarm finds the `CHECKED_FAULTS` before the run ends. They begin
at a third of the run; in a sequence of tasks at a third of the mean task, since only one task may load a spring."""
CHECKED_FAULTS = (
    "kind = 'spring_softened', target = 'joint_2', magnitude_factor = 0.8",
    "kind = 'drive_dead', target = 'drive_2'",
)


def tolerances_of(fleet: Fleet, say: Say = ignore_progress) -> tuple[RateTolerances, str]:
    """Load or compute the alarm's tolerances by sampling rate; return them and their origin; raise `TwinError`."""
    twin, digest = fleet.twin(), fleet_digest(fleet)
    cached = cache_folder("shadow") / f"{digest}.json"
    for path in (SHIPPED_FOLDER / f"{twin.name}.json", cached):
        found = read_tolerances(path, digest)
        if found is not None:
            return found, "shipped" if path != cached else "cached"
    limits = rate_limits(fleet, say)
    write_tolerances(cached, digest, limits)
    return limits, "computed"


def fleet_digest(fleet: Fleet) -> str:
    """Return the SHA-256 of all inputs that the tolerances of a fleet depend on, without twin's own code."""
    facts = [
        fleet.twin().values,
        fleet.robots,
        fleet.corners,
        fleet.seed,
        ZERO_RANGE,
        MAX_LOST_SHARE,
        MAX_STAMP_ERROR,
        TOLERANCE_MARGIN,
        MIN_TOLERANCE,
        PERIOD_FACTORS,
        CHECKED_FAULTS,
    ]
    return hashlib.sha256(json.dumps(facts, sort_keys=True, default=str).encode()).hexdigest()


def read_tolerances(path: Path, digest: str) -> RateTolerances | None:
    """Read the alarm's tolerances from a file; None if it is missing, or of another experiment or fleet."""
    try:
        facts = json.loads(path.read_text(encoding="utf-8"))
        if facts["digest"] != digest:
            return None
        return {float(rate): _with_nan(one) for rate, one in facts["rates_Hz"].items()}
    except (OSError, ValueError, KeyError, TypeError):
        return None


def write_tolerances(path: Path, digest: str, limits: RateTolerances) -> None:
    rates = {f"{rate:g}": asdict(one) for rate, one in limits.items()}
    write_text(path, json_text({"digest": digest, "rates_Hz": rates}, indent=1) + "\n")


def _with_nan(facts: Mapping[str, Mapping[str, float | None]]) -> Tolerances:
    return Tolerances(*({name: math.nan if value is None else value for name, value in facts[key].items()}
                        for key in ("tolerance", "sigma")))  # fmt: skip


def rate_limits(fleet: Fleet, say: Say = ignore_progress) -> RateTolerances:
    """Compute a fleet's alarm tolerances, for each sampling rate (Hz) fast enough to find the `CHECKED_FAULTS`."""
    twin = fleet.twin()

    def progress(what: str, share: float | None = None) -> None:
        say(f"tolerances of the alarm: {what}", share)

    limits = fleet_limits(fleet, PERIOD_FACTORS, progress)
    rates = [1.0 / (every * twin.controller_ticks * twin.cosim.tick) for every in PERIOD_FACTORS]
    found = {every: one for every, one in zip(PERIOD_FACTORS, limits, strict=True) if finds_faults(fleet, one, every)}
    return {rate: found[every] for rate, every in zip(rates, PERIOD_FACTORS, strict=True) if every in found}


def finds_faults(fleet: Fleet, limits: Tolerances, every: int = 1) -> bool:
    """Check whether the alarm finds the `CHECKED_FAULTS` in a robot as believed, with one in `every` samples."""
    twin = fleet.twin()
    fleet = replace(fleet, robots=((),))
    onset = round(twin.duration_ticks // (3 * max(1, len(twin.tasks))) * twin.cosim.tick, 9)
    for fault in CHECKED_FAULTS:
        samples = fleet.samples(0, every, [f"fault=[{{{fault}, onset_s = {onset}}}]"])
        alarms = watch_blocks(*block_means(twin, samples), ShadowWatch(limits, CHECKED_RATE))
        if not any(one.t > onset for one in alarms):
            return False
    return True
