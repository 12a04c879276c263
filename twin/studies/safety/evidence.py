"""Runs behind a line of a hazard table, with the monitor and without, and the judgement of the line."""

import hashlib
import json
import math
from collections.abc import Callable, Sequence
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import Any, Literal

from scipy.stats import binomtest

from twin.kernel.errors import TwinError
from twin.kernel.serialise import to_dict
from twin.robot.assembly.load import load_experiment
from twin.robot.experiment.together import fault_values
from twin.studies.faults.cases import faults_of, with_share
from twin.studies.faults.reaction import Reaction
from twin.studies.faults.stage import Stage
from twin.studies.safety.hazards import Cause, Hazard, SafetyTable

CONFIDENCE_LEVEL = 0.95
"""Confidence of intervals of a detected share, by Clopper and Pearson (1934)."""

Stages = Callable[[str, tuple[float, float]], Stage]
"""Return the stage of a body and an offset (m); the same one for repeated calls."""
Origin = Literal["grid", "search", "draw"]
"""Origin of a run: the grid of all causes, the search for a worse case, or a random draw."""
Status = Literal["kept", "kept unseen", "exceeded", "exceeded as stated", "failed"]
"""Judgement of a line; "unseen" if the monitor detects no run, "as stated" if the table explains the excess."""
GOOD_STATUSES = ("kept", "kept unseen")
"""Judgements of a line within its limit."""


@dataclass(frozen=True)
class EvidenceRun:
    """Run behind a hazard line, with its reactions with the monitor and without.

    Attributes:
        body, settings: body of the stage, and its `key=value`.
        watched: reaction with the monitor; None if the run failed.
        unwatched: reaction without the monitor; None if that run was not made.
        ideal: reaction of an ideal monitor, which cuts all power at the trip; None without a trip, or if not made.
    """

    cause: str
    body: str
    settings: tuple[str, ...]
    tables: tuple[dict[str, Any], ...]
    seed: int
    watched: Reaction | None = None
    unwatched: Reaction | None = None
    ideal: Reaction | None = None
    found: Origin = "grid"
    failure: str = ""

    JSON_KEYS = (
        "id cause body settings fault=tables seed found failure with_monitor=watched without_monitor=unwatched "
        "with_ideal_monitor=ideal"
    )

    @property
    def id(self) -> str:
        """Short id of a run: the first digits of the SHA-256 of body, settings, faults and seed."""
        made_of = [self.body, self.settings, self.tables, self.seed]
        return hashlib.sha256(json.dumps(made_of, sort_keys=True).encode()).hexdigest()[:12]

    def command(self, experiment: str) -> str:
        tables = ", ".join("{" + ", ".join(f"{k}={json.dumps(v)}" for k, v in one.items()) + "}" for one in self.tables)
        words = [f"twin run {experiment}", f"--body {self.body}", *(f"--set '{text}'" for text in self.settings)]
        return " ".join([*words, f"--set 'fault=[{tables}]'"])


@dataclass(frozen=True)
class HazardLine:
    """Line of the hazard table with its evidence: all runs, and the distances from violating a requirement.

    Attributes:
        runs: all runs: the grid of causes, then the search for a worse case, then random draws.
        distances: distance of the healthy robot from violating a requirement (SI), negative if violated; the key names
            formula, body and offset.
        variants: name of other hardware -> (peak force, force at the end) (N) of the line's worst run repeated with it;
            None if that run fails.
    """

    hazard: Hazard
    runs: tuple[EvidenceRun, ...]
    distances: dict[str, float]
    head_area: float
    variants: dict[str, tuple[float, float] | None] = field(default_factory=dict)

    def limited_value(self, run: Reaction) -> float:
        """Return the quantity of a run that the hazard's limit applies to, in the unit of the limit."""
        match self.hazard.limit_key:
            case "limit_kPa":
                return 1e-3 * run.peak / self.head_area
            case "limit_s":
                return math.inf if run.below is None else run.below
        return run.peak

    @property
    def failed_runs(self) -> list[EvidenceRun]:
        return [run for run in self.runs if run.watched is None]

    @property
    def worst(self) -> EvidenceRun | None:
        """Worst run of the line by the limited quantity, among runs that did not fail; None without such a run."""
        made = [(run, run.watched) for run in self.runs if run.watched is not None]
        worst = max(made, key=lambda pair: (self.limited_value(pair[1]), pair[1].peak), default=None)
        return worst and worst[0]

    @property
    def value(self) -> float:
        """Limited quantity of the line's worst run; 0 without runs."""
        worst = self.worst
        return self.limited_value(worst.watched) if worst and worst.watched else 0.0

    @property
    def status(self) -> Status:
        """Judgement of the hazard line; a single failed run makes the line fail."""
        if self.failed_runs or not (self.runs or self.distances):
            return "failed"
        violated = any(left < 0.0 for left in self.distances.values())
        if not violated and (self.worst is None or self.value <= self.hazard.limit):
            # a monitor that detects no run keeps no limit
            return "kept unseen" if self.detection[1] and not self.detection[0] else "kept"
        return "exceeded as stated" if self.hazard.table.beyond else "exceeded"

    @property
    def search_count(self) -> int:
        return len(self._runs_of("search"))

    def _runs_of(self, origin: Origin) -> list[EvidenceRun]:
        return [run for run in self.runs if run.watched is not None and run.found == origin]

    @property
    def grid_detection(self) -> tuple[int, int]:
        """Detected runs and all runs of the grid, (detected, all)."""
        return _detection_count(self._runs_of("grid"))

    @property
    def draw_detection(self) -> tuple[int, int]:
        """Detected runs and all runs of the independent random draws, (detected, all)."""
        return _detection_count(self._runs_of("draw"))

    @property
    def detection(self) -> tuple[int, int]:
        """Detected runs and all runs: of the random draws if there are any, else of the grid."""
        return self.draw_detection if self.draw_detection[1] else self.grid_detection

    @property
    def dangerous_count(self) -> tuple[int, int]:
        """Count (draws below the limit with the monitor, random draws that exceed the limit or fail without it)."""
        bad = [
            run
            for run in self._runs_of("draw")
            if run.unwatched and (run.unwatched.failure or self.limited_value(run.unwatched) > self.hazard.limit)
        ]
        return sum(bool(run.watched and self.limited_value(run.watched) <= self.hazard.limit) for run in bad), len(bad)

    def to_dict(self) -> dict[str, Any]:
        worst = self.worst
        seen, made = self.grid_detection
        return {
            "id": self.hazard.table.id,
            **self.hazard.table.model_dump(),
            "causes": [str(cause) for cause in self.hazard.causes],
            "limit_key": self.hazard.limit_key,
            "limit": self.hazard.limit,
            "status": self.status,
            "value": None if math.isinf(self.value) else self.value,
            "worst": worst and worst.id,
            "peak_N": worst.watched.peak if worst and worst.watched else None,
            "detected": seen,
            "runs": made,
            "searched": self.search_count,
            "drawn": _share_to_dict(self.draw_detection),
            "dangerous": _share_to_dict(self.dangerous_count),
            "distances": self.distances,
            "variants": self.variants,
            "evidence": to_dict(self.runs),
        }


def interval(share: tuple[int, int]) -> tuple[float, float]:
    """Compute the confidence interval of a share (count, number >= 1), by Clopper and Pearson (1934)."""
    found = binomtest(*share).proportion_ci(CONFIDENCE_LEVEL, method="exact")
    return float(found.low), float(found.high)


def _detection_count(runs: Sequence[EvidenceRun]) -> tuple[int, int]:
    return sum(bool(run.watched and run.watched.reason) for run in runs), len(runs)


def _share_to_dict(share: tuple[int, int]) -> dict[str, Any] | None:
    return {"count": share[0], "of": share[1], "interval": list(interval(share))} if share[1] else None


def record_of(
    stage: Stage,
    cause: Cause | str,
    tables: Sequence[dict[str, Any]] = (),
    found: Origin = "grid",
    failure: str = "",
) -> EvidenceRun:
    """Return the record of a run on a stage, without reactions: one to be made, or a failed one."""
    seed = stage.experiment.seed
    return EvidenceRun(str(cause), stage.body, stage.settings, tuple(tables), seed, found=found, failure=failure)


def run_of(
    stage: Stage, cause: Cause, tables: Sequence[dict[str, Any]], found: Origin = "grid", delay: float = 0.0
) -> EvidenceRun:
    """Run a cause with the monitor, a random draw also without; a refused or failed run is kept as failed."""
    one = record_of(stage, cause, tables, found)
    try:
        if cause.ordered:
            one = replace(one, tables=stage.delay_second(tables, delay))
        faults = faults_of(stage.experiment, one.tables)
        watched, unwatched = stage.reactions(faults) if found == "draw" else (stage.reaction(faults), None)
    except TwinError as problem:
        return replace(one, failure=str(problem))
    meant = any(kind == "drive_failure" for kind, _ in cause.faults)
    if watched.failure and not meant:
        return replace(one, failure=watched.failure)
    return replace(one, watched=watched, unwatched=unwatched)


def tables_of(cause: Cause, sizes: Sequence[float | None], onset: float, seed: int = 0) -> list[dict[str, Any]]:
    """Create the [[fault]] tables of `cause`, all at `onset` (s); `run_of` delays the second of an ordered cause."""
    parts = zip(cause.faults, sizes, strict=True)
    made = [with_share(fault_values(kind, target, size, onset)) for (kind, target), size in parts]
    return [one | ({"seed": seed} if seed else {}) for one in made]


def add_reference_runs(stage: Stage, run: EvidenceRun) -> EvidenceRun:
    faults = faults_of(stage.experiment, run.tables)
    seen = None if run.watched is None else run.watched.seen
    ideal = None if seen is None else stage.ideal_reaction(faults, seen)
    return replace(run, unwatched=run.unwatched or stage.reaction(faults, watched=False), ideal=ideal)


def variant_peaks(
    line: HazardLine, table_: SafetyTable, path: Path, stage: Stage | None
) -> dict[str, tuple[float, float] | None]:
    """Return (peak, left) in N of the line's worst run by variant of the hardware; None if that run fails."""
    worst = line.worst
    if worst is None or stage is None:
        return {}
    found: dict[str, tuple[float, float] | None] = {}
    for variant in table_.variants:
        try:
            experiment = load_experiment(path, (*stage.settings, *variant.set), None, stage.body)
            run = Stage(experiment, share=False).reaction(faults_of(experiment, worst.tables))
            found[variant.name] = None if run.failure else (run.peak, run.left)
        except TwinError:
            found[variant.name] = None
    return found
